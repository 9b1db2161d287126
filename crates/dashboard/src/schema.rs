//! The JSON schema of everything under `/v1`, derived from the structs and the table of commands.

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};

use crate::command::{
    COMMANDS, CommandRow, CommandTarget, FLEET_ROBOT_FIELD, FieldKind, MAX_FLEET_ROBOT_CHARS, ROBOT_FIELD,
};
use crate::model::{
    Accepted, CameraRow, FleetState, Hello, Message, ParameterRow, RecordingRow, Refusal, RobotRow, SourceRow, State,
};

/// The file `schema/v1.json` holds it, and a test compares the two.
pub fn schema() -> Value {
    let mut generator = SchemaSettings::draft2020_12().into_generator();
    let answers = json!({
        "GET /v1/stream": reference::<Message>(&mut generator),
        "GET /v1/state": reference::<State>(&mut generator),
        "GET /v1/robots": reference::<Vec<RobotRow>>(&mut generator),
        "GET /v1/sources": reference::<Vec<SourceRow>>(&mut generator),
        "GET /v1/parameters": reference::<Vec<ParameterRow>>(&mut generator),
        "GET /v1/cameras": reference::<Vec<CameraRow>>(&mut generator),
        "GET /v1/fleet": reference::<FleetState>(&mut generator),
        "GET /v1/recordings": reference::<Vec<RecordingRow>>(&mut generator),
        "GET /v1/recordings/{name}/replay": reference::<crate::model::Frame>(&mut generator),
        "POST /v1/commands": reference::<Accepted>(&mut generator),
        "refused": reference::<Refusal>(&mut generator),
    });
    reference::<Hello>(&mut generator);
    let commands: Vec<Value> = COMMANDS.iter().map(command_schema).collect();
    let mut definitions = generator.take_definitions(true);
    definitions.insert("Command".to_owned(), json!({ "oneOf": commands }));
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "posebridge /v1",
        "answers": answers,
        "requests": { "POST /v1/commands": { "$ref": "#/$defs/Command" } },
        "$defs": definitions,
    })
}

fn reference<T: JsonSchema>(generator: &mut SchemaGenerator) -> Value {
    generator.subschema_for::<T>().to_value()
}

fn command_schema(row: &CommandRow) -> Value {
    let mut properties = Map::new();
    properties.insert("command".to_owned(), json!({ "const": row.name }));
    let mut required = vec!["command"];
    if row.target == CommandTarget::Robot {
        let robot = json!({ "type": "string", "pattern": "^[0-9]+/[0-9]+/[0-9]+$" });
        properties.insert(ROBOT_FIELD.to_owned(), robot);
        let fleet_robot = json!({ "type": "string", "minLength": 1, "maxLength": MAX_FLEET_ROBOT_CHARS });
        properties.insert(FLEET_ROBOT_FIELD.to_owned(), fleet_robot);
    }
    for field in row.fields {
        properties.insert(field.name.to_owned(), field_schema(field.kind_in(row.name)));
        required.push(field.name);
    }
    json!({
        "type": "object",
        "description": row.help,
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}

fn field_schema(kind: FieldKind) -> Value {
    match kind {
        FieldKind::Number { least, most } => {
            json!({ "type": "number", "minimum": least, "maximum": most })
        }
        FieldKind::Finite => json!({ "type": "number" }),
        // No field of the table is without a range; a test checks all.
        FieldKind::Simulated => json!(false),
        FieldKind::Integer { least, most } => {
            json!({ "type": "integer", "minimum": least, "maximum": most })
        }
        FieldKind::Choice(words) => json!({ "enum": words }),
        FieldKind::Switch => json!({ "type": "boolean" }),
        FieldKind::Name => json!({ "type": "string", "minLength": 1, "maxLength": 16 }),
        FieldKind::NameOrNull => {
            json!({ "type": ["string", "null"], "minLength": 1, "maxLength": 16 })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_schema_file_is_that_of_the_structs() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/schema/v1.json");
        let made = serde_json::to_string_pretty(&schema()).unwrap() + "\n";
        if std::env::var_os("POSEBRIDGE_WRITE_SCHEMA").is_some() {
            std::fs::write(path, &made).unwrap();
        }
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            kept == made,
            "schema/v1.json is not that of the structs: run this test with POSEBRIDGE_WRITE_SCHEMA=1 and look at the difference"
        );
    }
}
