//! Keys, tokens and attachments are those that the Python package zenoh-ros2-sdk 0.1.8 makes of the same values.

use posebridge_fleet::{EndpointKind, RosAttachment, RosEndpoint, RosName, RosNameError, RosNode, RosQos, RosType};
use proptest::prelude::*;

const HASH: &str = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";

fn node(namespace: Option<&str>) -> RosNode {
    RosNode {
        domain: 7,
        session: "8a1f03c2d5e64b7790aa12bc34de56f0".to_owned(),
        namespace: namespace.map(|name| RosName::new(name).expect("it is a name")),
        name: "posebridge".to_owned(),
    }
}

#[test]
fn a_node_is_announced_as_rmw_zenoh_does() {
    let session = "@ros2_lv/7/8a1f03c2d5e64b7790aa12bc34de56f0/0/0/NN/%";
    assert_eq!(node(Some("/robot1")).token(), format!("{session}/%robot1/posebridge"));
    assert_eq!(node(None).token(), format!("{session}/%/posebridge"));
}

#[test]
fn topics_are_announced_and_named_as_rmw_zenoh_does() {
    for (kind, qos, topic, message, token, key) in [
        (
            EndpointKind::Publisher,
            RosQos::Default,
            "/robot1/odom",
            "nav_msgs/msg/Odometry",
            format!("MP/%/%robot1/posebridge/%robot1%odom/nav_msgs::msg::dds_::Odometry_/{HASH}/::,10:,:,:,,"),
            format!("7/robot1/odom/nav_msgs::msg::dds_::Odometry_/{HASH}"),
        ),
        (
            EndpointKind::Subscription,
            RosQos::SensorData,
            "/robot1/cmd_vel",
            "geometry_msgs/msg/Twist",
            format!("MS/%/%robot1/posebridge/%robot1%cmd_vel/geometry_msgs::msg::dds_::Twist_/{HASH}/2::,5:,:,:,,"),
            format!("7/robot1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{HASH}"),
        ),
        (
            EndpointKind::Publisher,
            RosQos::Latched,
            "/tf_static",
            "tf2_msgs/msg/TFMessage",
            format!("MP/%/%robot1/posebridge/%tf_static/tf2_msgs::msg::dds_::TFMessage_/{HASH}/:1:,1:,:,:,,"),
            format!("7/tf_static/tf2_msgs::msg::dds_::TFMessage_/{HASH}"),
        ),
    ] {
        let (node, topic) = (node(Some("/robot1")), RosName::new(topic).unwrap());
        let message = RosType { name: message, hash: HASH };
        let endpoint = RosEndpoint { node: &node, id: 3, kind, topic: &topic, message, qos };
        assert_eq!(endpoint.token(), format!("@ros2_lv/7/8a1f03c2d5e64b7790aa12bc34de56f0/0/3/{token}"));
        assert_eq!(endpoint.key(), key);
    }
}

#[test]
fn an_attachment_has_the_bytes_of_rmw_zenoh() {
    let publisher: [u8; 16] = std::array::from_fn(|at| at as u8);
    let attachment = RosAttachment { sequence: 258, source_nanos: 1_790_000_000_123_456_789, publisher };
    let bytes = attachment.encode();
    let numbers = [0x02, 0x01, 0, 0, 0, 0, 0, 0, 0x15, 0xCD, 0x4E, 0x2B, 0x84, 0x5B, 0xD7, 0x18, 0x10];
    assert_eq!(bytes.to_vec(), [&numbers[..], &publisher].concat());
    assert_eq!(RosAttachment::decode(&bytes), Some(attachment));
}

#[test]
fn what_ros_does_not_accept_is_no_name() {
    for (text, error) in [
        ("odom", RosNameError::Relative),
        ("/", RosNameError::Part),
        ("/a//b", RosNameError::Part),
        ("/a/", RosNameError::Part),
        ("/a/1b", RosNameError::Part),
        ("/a/*", RosNameError::Character('*')),
        ("/a__b", RosNameError::Character('_')),
        ("/h\u{fc}", RosNameError::Character('\u{fc}')),
    ] {
        assert_eq!(RosName::new(text), Err(error), "{text}");
    }
    assert_eq!(RosName::new(&format!("/{}", "a".repeat(255))), Err(RosNameError::TooLong));
    assert!(RosName::new(&format!("/{}", "a".repeat(254))).is_ok());
}

proptest! {
    #[test]
    fn any_bytes_are_an_attachment_or_none(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
        if let Some(read) = RosAttachment::decode(&bytes) {
            prop_assert_eq!(read.encode().to_vec(), bytes);
        }
    }

    /// Nothing in a name reaches beyond its chunk of a key.
    #[test]
    fn any_text_is_refused_or_a_chunk_of_a_token(text in "/?[a-z0-9_/%$#?*@. -]{0,12}") {
        if let Ok(name) = RosName::new(&text) {
            prop_assert!(name.as_str().chars().all(|letter| letter.is_ascii_alphanumeric() || "_/".contains(letter)));
        }
    }
}
