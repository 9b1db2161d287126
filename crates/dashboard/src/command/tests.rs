use super::*;

use posebridge_telemetry::simulator::NUMBER_FIELDS;
use posebridge_telemetry::{
    Address, LinkId, SensorId, SensorSwitch, SimulatorCommand, SlippingWheel, SteeringSource, TimeDelta,
};
use serde_json::json;

fn error_text(text: &str) -> String {
    parse(text.as_bytes()).unwrap_err().to_string()
}

/// What a field takes, at one end of its range.
fn example(kind: FieldKind) -> Value {
    match kind {
        FieldKind::Number { least, .. } => json!(least),
        FieldKind::Finite => json!(0.5),
        FieldKind::Simulated => panic!("a field of the simulator has no range"),
        FieldKind::Integer { most, .. } => json!(most),
        FieldKind::Choice(words) => json!(words[0]),
        FieldKind::Switch => json!(true),
        FieldKind::Name => json!("gate_prob"),
        FieldKind::NameOrNull => json!(null),
    }
}

/// A command of this row.
fn complete_command(row: &CommandRow) -> Map<String, Value> {
    let mut object = Map::new();
    object.insert("command".to_owned(), json!(row.name));
    for field in row.fields {
        object.insert(field.name.to_owned(), example(field.kind_in(row.name)));
    }
    object
}

fn to_text(object: Map<String, Value>) -> String {
    Value::Object(object).to_string()
}

#[test]
fn every_row_reads_its_own_fields_and_misses_each_of_them() {
    for row in COMMANDS {
        let complete = complete_command(row);
        let ParsedCommand { name, robot, command } = parse(to_text(complete.clone()).as_bytes()).unwrap();
        assert_eq!((name, robot), (row.name, None));
        assert_eq!(command.is_for_robots(), row.target == CommandTarget::Robot, "{name}");
        if let Command::Simulator(simulated) = command {
            assert_eq!(simulated.name(), row.name);
            assert_eq!(simulated.validate(), Ok(()), "{}", row.name);
        }
        for field in row.fields {
            let mut lacking = complete.clone();
            lacking.remove(field.name);
            let why = error_text(&to_text(lacking));
            let expected = format!("`{}` needs the field `{}`: ", row.name, field.name);
            assert!(why.starts_with(&expected), "{why}");
            let mut wrong = complete.clone();
            wrong.insert(field.name.to_owned(), json!([1, "\u{1b}[2J"]));
            let why = error_text(&to_text(wrong));
            assert!(why.contains(&format!("the field `{}` is [", field.name)), "{why}");
            assert!(!why.contains('\u{1b}'), "{why}");
        }
        let mut more = complete;
        more.insert("extra".to_owned(), json!(1));
        let why = error_text(&to_text(more));
        assert!(why.contains("has no field `extra`; it has: "), "{why}");
    }
}

#[test]
fn every_number_of_the_simulator_has_a_field_with_its_range() {
    for known in NUMBER_FIELDS {
        let row = COMMANDS.iter().find(|row| row.name == known.command);
        let fields = row.unwrap().fields;
        let field = fields.iter().find(|field| field.name == known.field);
        let FieldKind::Number { least, most } = field.unwrap().kind_in(known.command) else {
            panic!("{} is a number", known.field);
        };
        assert_eq!((least, most), (known.minimum, known.maximum));
    }
}

#[test]
fn the_words_are_those_of_the_vocabulary() {
    let words = |name: &str, field: &str| {
        let row = COMMANDS.iter().find(|row| row.name == name).unwrap();
        let field = row.fields.iter().find(|one| one.name == field).unwrap();
        let FieldKind::Choice(words) = field.kind else {
            panic!("{name} has words");
        };
        words.to_vec()
    };
    assert_eq!(words("slip", "wheel"), SlippingWheel::ALL.map(SlippingWheel::as_str));
    assert_eq!(words("steering", "by"), SteeringSource::ALL.map(SteeringSource::as_str));
}

#[test]
fn commands_are_what_their_fields_say() {
    let read = |text: &str| parse(text.as_bytes()).unwrap().command;
    let Command::SetPose { pose, position_sigma_m, heading_sigma_rad } = read(
        r#"{"command":"set-pose","x_m":1.5,"y_m":-2,"heading_rad":0.5,"position_sigma_m":0.1,"heading_sigma_rad":0.2}"#,
    ) else {
        panic!("it sets the pose");
    };
    assert_eq!((pose.x.0, pose.y.0, pose.heading.rad()), (1.5, -2.0, 0.5));
    assert_eq!((position_sigma_m, heading_sigma_rad), (0.1, 0.2));
    assert_eq!(
        read(r#"{"command":"switch-source","sensor":3,"on":false}"#),
        Command::SwitchSource { sensor: SensorId::CAMERA, to: SensorSwitch::Off }
    );
    assert_eq!(
        read(r#"{"command":"slip","wheel":"right","factor":0.5,"seconds":2}"#),
        Command::Simulator(SimulatorCommand::Slip {
            wheel: SlippingWheel::Right,
            factor: 0.5,
            duration: TimeDelta::from_millis(2_000)
        })
    );
    assert_eq!(
        read(r#"{"command":"camera-delay","delay_ms":5000}"#),
        Command::Simulator(SimulatorCommand::CameraDelay { delay: TimeDelta::from_millis(5_000) })
    );
    let profile = |text: &str| {
        let command = read(text);
        let Command::Simulator(SimulatorCommand::LinkProfile(profile)) = command else {
            panic!("{command:?}");
        };
        profile.map(|name| name.to_string())
    };
    assert_eq!(profile(r#"{"command":"link-profile","profile":"bluetooth-spp"}"#).as_deref(), Some("bluetooth-spp"));
    assert_eq!(profile(r#"{"command":"link-profile","profile":null}"#), None);
}

#[test]
fn a_command_for_a_robot_is_an_input_for_that_one() {
    let read = |text: &str| parse(text.as_bytes()).unwrap().input();
    assert_eq!(read(r#"{"command":"reset-pose"}"#), Input::Command(Command::ResetPose));
    let robot = RobotId { link: LinkId(300), address: Address::new(7, 255) };
    assert_eq!(
        read(r#"{"command":"reset-pose","robot":"300/7/255"}"#),
        Input::RobotCommand { robot, command: Command::ResetPose }
    );
    for wrong in ["7", r#""left""#, r#""0/7""#, r#""0/7/1/2""#, r#""0/256/1""#, r#""0/+7/1""#, r#""65536/1/1""#, "null"]
    {
        let why = error_text(&format!(r#"{{"command":"reset-pose","robot":{wrong}}}"#));
        let expected = r#"must be the id of a robot as /v1/robots has it, such as "0/1/1""#;
        assert_eq!(why, format!("`reset-pose`: the field `robot` is {wrong}, {expected}"));
    }
    let why = error_text(r#"{"command":"stop-recording","robot":"0/7/1"}"#);
    assert_eq!(why, "`stop-recording` has no field `robot`; it has: none");
}

#[test]
fn what_makes_no_sense_is_refused_with_what_may_stand_there() {
    assert!(error_text("{").starts_with("the command is no JSON: "));
    assert_eq!(error_text("[]"), "a command is an object such as {\"command\": \"reset-pose\"}");
    assert!(error_text("{}").starts_with("the field `command` is missing; it is one of: reset-pose, "));
    assert!(error_text(r#"{"command":7}"#).starts_with("`command` is `7`; there are: "));
    assert!(error_text(r#"{"command":"fly"}"#).starts_with("`command` is `fly`; there are: "));
    assert_eq!(
        error_text(r#"{"command":"kidnap","forward_m":11,"left_m":0,"turn_rad":0}"#),
        "`kidnap`: the field `forward_m` is 11, must be a number from -10 to 10"
    );
    assert_eq!(
        error_text(r#"{"command":"switch-source","sensor":3.5,"on":true}"#),
        "`switch-source`: the field `sensor` is 3.5, must be a whole number from 0 to 255"
    );
    assert_eq!(
        error_text(r#"{"command":"steering","by":"truth"}"#),
        "`steering`: the field `by` is \"truth\", must be one of \"odometry\", \"estimate\""
    );
    assert_eq!(
        error_text(r#"{"command":"set-parameter","name":"gate_prob","value":"0.9"}"#),
        "`set-parameter`: the field `value` is \"0.9\", must be a finite number"
    );
    let long = "x".repeat(10_000);
    assert!(error_text(&format!(r#"{{"command":"{long}"}}"#)).len() < 1_000);
}

#[test]
fn a_command_for_a_robot_of_the_fleet_keeps_its_fields_and_loses_the_robot() {
    let read = |text: &str| parse_request(text.as_bytes());
    let CommandRequest::Fleet(request) =
        read(r#"{"command":"switch-source","sensor":3,"on":false,"fleet_robot":"ada"}"#).unwrap()
    else {
        panic!("it is for a robot of the fleet");
    };
    assert_eq!((request.name, request.robot.as_str()), ("switch-source", "ada"));
    assert_eq!(request.command, json!({ "command": "switch-source", "sensor": 3, "on": false }));
    let own = read(r#"{"command":"reset-pose","robot":"0/1/1"}"#).unwrap();
    assert_eq!(own, CommandRequest::Own(parse(br#"{"command":"reset-pose","robot":"0/1/1"}"#).unwrap()));

    let error = |text: &str| read(text).unwrap_err().to_string();
    let long = format!(r#"{{"command":"reset-pose","fleet_robot":"{}"}}"#, "x".repeat(65));
    for wrong in [r#"{"command":"reset-pose","fleet_robot":7}"#, r#"{"command":"reset-pose","fleet_robot":""}"#, &long]
    {
        let why = error(wrong);
        assert!(why.ends_with("must be the name of a robot as /v1/fleet has it") && why.len() < 200, "{why}");
    }
    let both = error(r#"{"command":"reset-pose","robot":"0/1/1","fleet_robot":"ada"}"#);
    assert!(both.starts_with("`reset-pose` has both `robot` and `fleet_robot`; "), "{both}");
    assert_eq!(
        error(r#"{"command":"stop-recording","fleet_robot":"ada"}"#),
        "`stop-recording` has no field `fleet_robot`; it has: none"
    );
    assert!(error(r#"{"command":"switch-source","fleet_robot":"ada"}"#).contains("needs the field `sensor`"));
    assert!(error(r#"{"fleet_robot":"ada"}"#).starts_with("the field `command` is missing"));
}
