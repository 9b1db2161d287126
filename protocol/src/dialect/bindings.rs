//! Our dialect as files for foreign tools: pymavlink, Wireshark, the stock C library of MAVLink. Each works beside the stock dialect that the
//! tool has, so that nothing need be generated or installed.
//!
//! The fixed part of each file is a template in `bindings/`; what changes with the definition is inserted at its marks.

use std::fmt::{Display, Write as _};

use super::definitions::{FieldDefinition, MessageDefinition, definitions};
use super::generated::posebridge;

const XML: &str = include_str!("../../definitions/posebridge.xml");
const PYTHON: &str = include_str!("bindings/posebridge_mavlink.py");
const WIRESHARK: &str = include_str!("bindings/posebridge_mavlink.lua");
const C: &str = include_str!("bindings/posebridge_mavlink.h");

/// Who reads or writes our messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// Programs with pymavlink: a module that adds our messages to the dialect in use.
    Python,
    /// Wireshark and tshark: a dissector of our messages in Lua.
    Wireshark,
    /// Programs with mavgen's C headers: one more header.
    C,
    /// Generators of other languages: the definition.
    Xml,
}

impl Binding {
    /// The name that its users include or import it by.
    pub const fn file_name(self) -> &'static str {
        match self {
            Self::Python => "posebridge_mavlink.py",
            Self::Wireshark => "posebridge_mavlink.lua",
            Self::C => "posebridge_mavlink.h",
            Self::Xml => "posebridge.xml",
        }
    }

    /// The content of the file.
    pub fn text(self) -> String {
        match self {
            Self::Python => PYTHON.replace("@MESSAGES@", &joined(python_message)),
            Self::Wireshark => WIRESHARK.replace("@MESSAGES@", &joined(lua_message)),
            Self::C => C.replace("@ENTRIES@", &joined(c_entry)).replace("@MESSAGES@\n", &joined(c_message)),
            Self::Xml => XML.to_owned(),
        }
    }
}

fn joined(text_of: fn(&MessageDefinition) -> String) -> String {
    let own = definitions().iter().filter(|message| posebridge::MavMessage::all_ids().contains(&message.id));
    own.map(text_of).collect()
}

fn elements(field: &FieldDefinition) -> u8 {
    field.array.unwrap_or(0)
}

fn python_message(message: &MessageDefinition) -> String {
    let MessageDefinition { id, name, layout, fields } = message;
    let mut text = format!("    ({id}, \"{name}\", {}, (\n", layout.crc_extra);
    for field in fields {
        let (name, kind, elements) = (field.name, field.scalar.c_type(), elements(field));
        let unit = field.unit.map_or_else(|| "None".to_owned(), |unit| format!("\"{unit}\""));
        write_line(&mut text, format_args!("        (\"{name}\", \"{kind}\", {elements}, {unit}),"));
    }
    text + "    )),\n"
}

fn lua_message(message: &MessageDefinition) -> String {
    let MessageDefinition { id, name, layout, fields } = message;
    let (crc_extra, length) = (layout.crc_extra, layout.max_len_v2);
    let mut text =
        format!("  [{id}] = {{ name = \"{name}\", crc_extra = {crc_extra}, length = {length}, fields = {{\n");
    for field in fields {
        let (name, kind, elements) = (field.name, field.scalar.c_type().trim_end_matches("_t"), elements(field));
        let unit = field.unit.map_or_else(String::new, |unit| format!(", \"{unit}\""));
        write_line(&mut text, format_args!("    {{ \"{name}\", \"{kind}\", {elements}{unit} }},"));
    }
    text + "  } },\n"
}

/// As the table of mavgen; none of our messages names a target, so that the last three are zero.
fn c_entry(message: &MessageDefinition) -> String {
    let layout = message.layout;
    let (id, crc_extra, shortest, longest) = (message.id, layout.crc_extra, layout.max_len_v1, layout.max_len_v2);
    format!("        {{{id}, {crc_extra}, {shortest}, {longest}, 0, 0, 0}},\n")
}

/// The struct of a message with the functions that mavgen calls `_encode`, `_encode_chan` and `_decode`.
fn c_message(message: &MessageDefinition) -> String {
    let (upper, lower) = (message.name, message.name.to_lowercase());
    let (shortest, longest) = (message.layout.max_len_v1, message.layout.max_len_v2);
    let mut members = String::new();
    let mut puts = String::new();
    let mut gets = String::new();
    for field in &message.fields {
        let FieldDefinition { name, offset, .. } = *field;
        let kind = field.scalar.c_type();
        let length = field.array.map_or_else(String::new, |elements| format!("[{elements}]"));
        let unit = field.unit.map_or_else(String::new, |unit| format!(" /* {unit} */"));
        write_line(&mut members, format_args!("    {kind} {name}{length};{unit}"));
        if let Some(elements) = field.array {
            write_line(
                &mut puts,
                format_args!("    _mav_put_{kind}_array(payload, {offset}, from->{name}, {elements});"),
            );
            write_line(
                &mut gets,
                format_args!("    _MAV_RETURN_{kind}_array(message, to->{name}, {elements}, {offset});"),
            );
        } else {
            write_line(&mut puts, format_args!("    _mav_put_{kind}(payload, {offset}, from->{name});"));
            write_line(&mut gets, format_args!("    to->{name} = _MAV_RETURN_{kind}(message, {offset});"));
        }
    }
    format!(
        "
#define MAVLINK_MSG_ID_{upper} {id}
#define MAVLINK_MSG_ID_{upper}_MIN_LEN {shortest}
#define MAVLINK_MSG_ID_{upper}_LEN {longest}
#define MAVLINK_MSG_ID_{upper}_CRC {crc_extra}

typedef struct {{
{members}}} mavlink_{lower}_t;

static inline void posebridge_put_{lower}(mavlink_message_t *message, const mavlink_{lower}_t *from)
{{
    char payload[MAVLINK_MSG_ID_{upper}_LEN];
{puts}    memcpy(_MAV_PAYLOAD_NON_CONST(message), payload, sizeof(payload));
    message->msgid = MAVLINK_MSG_ID_{upper};
}}

static inline uint16_t mavlink_msg_{lower}_encode(
    uint8_t system, uint8_t component, mavlink_message_t *message, const mavlink_{lower}_t *from)
{{
    posebridge_put_{lower}(message, from);
    return mavlink_finalize_message(message, system, component,
        MAVLINK_MSG_ID_{upper}_MIN_LEN, MAVLINK_MSG_ID_{upper}_LEN, MAVLINK_MSG_ID_{upper}_CRC);
}}

static inline uint16_t mavlink_msg_{lower}_encode_chan(
    uint8_t system, uint8_t component, uint8_t channel, mavlink_message_t *message, const mavlink_{lower}_t *from)
{{
    posebridge_put_{lower}(message, from);
    return mavlink_finalize_message_chan(message, system, component, channel,
        MAVLINK_MSG_ID_{upper}_MIN_LEN, MAVLINK_MSG_ID_{upper}_LEN, MAVLINK_MSG_ID_{upper}_CRC);
}}

static inline void mavlink_msg_{lower}_decode(const mavlink_message_t *message, mavlink_{lower}_t *to)
{{
{gets}}}
",
        id = message.id,
        crc_extra = message.layout.crc_extra,
    )
}

fn write_line(text: &mut String, line: impl Display) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{line}");
}
