//! The types of the messages in a bag, with their definitions and hashes.
//!
//! # Sources
//! Field lists: common_interfaces (`nav_msgs`, `geometry_msgs`, `sensor_msgs`, `diagnostic_msgs`, `std_msgs`), rcl_interfaces
//! (`builtin_interfaces`) and geometry2 (`tf2_msgs`) of ROS 2 Jazzy; see `NOTICE`. Hashes: REP 2016, as rosbags 0.11.9 computes them of
//! its own definitions. The concatenation: rosbag2, `message_definition_cache.cpp`.

use std::collections::VecDeque;

/// What separates the definitions in a schema.
const SEPARATOR: &str = "================================================================================";

/// A type of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageType {
    /// `package/msg/Type`.
    pub name: &'static str,
    /// Of all its fields, by which programs know that two have the same definition.
    pub hash: &'static str,
}

pub(super) const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    hash: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
};
pub(super) const POSE_WITH_COVARIANCE_STAMPED: MessageType = MessageType {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    hash: "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
};
pub(super) const IMU: MessageType = MessageType {
    name: "sensor_msgs/msg/Imu",
    hash: "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
};
pub(super) const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
};
pub(super) const DIAGNOSTIC_ARRAY: MessageType = MessageType {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
};

macro_rules! definition {
    ($name:literal) => {
        ($name, include_str!(concat!("schemas/", $name, ".msg")))
    };
}

/// The field list of each type, by its name as other definitions have it.
const DEFINITIONS: &[(&str, &str)] = &[
    definition!("builtin_interfaces/Time"),
    definition!("diagnostic_msgs/DiagnosticArray"),
    definition!("diagnostic_msgs/DiagnosticStatus"),
    definition!("diagnostic_msgs/KeyValue"),
    definition!("geometry_msgs/Point"),
    definition!("geometry_msgs/Pose"),
    definition!("geometry_msgs/PoseWithCovariance"),
    definition!("geometry_msgs/PoseWithCovarianceStamped"),
    definition!("geometry_msgs/Quaternion"),
    definition!("geometry_msgs/Transform"),
    definition!("geometry_msgs/TransformStamped"),
    definition!("geometry_msgs/Twist"),
    definition!("geometry_msgs/TwistWithCovariance"),
    definition!("geometry_msgs/Vector3"),
    definition!("nav_msgs/Odometry"),
    definition!("sensor_msgs/Imu"),
    definition!("std_msgs/Header"),
    definition!("tf2_msgs/TFMessage"),
];

impl MessageType {
    /// Its definition and those of all types that it names, as a schema of the encoding `ros2msg` has them.
    pub(super) fn schema(self) -> String {
        let root = self.name.replace("/msg/", "/");
        let mut sections = vec![fields_of(&root).to_owned()];
        let mut known = vec![root.clone()];
        let mut waiting: VecDeque<&str> = named_types(fields_of(&root)).collect();
        while let Some(name) = waiting.pop_front() {
            if known.iter().any(|one| one == name) {
                continue;
            }
            known.push(name.to_owned());
            sections.push(format!("{SEPARATOR}\nMSG: {name}\n{}", fields_of(name)));
            waiting.extend(named_types(fields_of(name)));
        }
        sections.concat()
    }
}

/// Empty for an unknown type; a test finds it.
fn fields_of(name: &str) -> &'static str {
    DEFINITIONS.iter().find(|(known, _)| *known == name).map_or("", |(_, fields)| fields)
}

/// The types of fields that are messages themselves.
fn named_types(fields: &'static str) -> impl Iterator<Item = &'static str> {
    let types = fields.lines().filter_map(|line| line.split_whitespace().next());
    types.map(|name| name.split('[').next().unwrap_or(name)).filter(|name| name.contains('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_named_type_is_defined_once_in_a_schema() {
        for (root, sections) in
            [(ODOMETRY, 10), (POSE_WITH_COVARIANCE_STAMPED, 7), (IMU, 5), (TF_MESSAGE, 7), (DIAGNOSTIC_ARRAY, 5)]
        {
            let schema = root.schema();
            let parts: Vec<&str> = schema.split(&format!("{SEPARATOR}\n")).collect();
            assert_eq!(parts.len(), sections, "{schema}");
            for (index, part) in parts.iter().enumerate() {
                let (heading, fields) = if index == 0 { ("", *part) } else { part.split_once('\n').unwrap() };
                assert!(index == 0 || heading.starts_with("MSG: "), "{heading}");
                assert!(fields.lines().count() > 0, "{heading}");
            }
        }
    }

    #[test]
    fn every_definition_is_used() {
        let all = [ODOMETRY, POSE_WITH_COVARIANCE_STAMPED, IMU, TF_MESSAGE, DIAGNOSTIC_ARRAY];
        let schemas: String = all.map(MessageType::schema).concat();
        for (name, fields) in DEFINITIONS {
            let is_root = all.iter().any(|root| root.name.replace("/msg/", "/") == *name);
            assert!(is_root || schemas.contains(&format!("MSG: {name}\n{fields}")), "{name}");
        }
    }
}
