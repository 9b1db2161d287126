//! Keys as text, both ways.

use posebridge_fleet::{
    CameraName, Epoch, FleetKey, FleetKeys, FleetName, KeyError, LinkName, NameError, OwnershipToken, RobotName,
    StationId, StationName,
};
use proptest::prelude::*;

fn keys() -> FleetKeys {
    FleetKeys::new(FleetName::new("lab").expect("a name"))
}

fn examples() -> [(&'static str, FleetKey); 7] {
    let robot = || RobotName::new("nxt-7").expect("a name");
    let station = || StationId { name: StationName::new("north").expect("a name"), instance: 0xab };
    let token = OwnershipToken { epoch: Epoch::new(4_294_967_295).expect("not zero"), station: station() };
    [
        ("pb/lab/nxt-7/raw/usb0", FleetKey::Raw { robot: robot(), link: LinkName::new("usb0").expect("a name") }),
        ("pb/lab/nxt-7/est", FleetKey::Estimate { robot: robot() }),
        ("pb/lab/nxt-7/fix/top.1", FleetKey::Fix { robot: robot(), camera: CameraName::new("top.1").expect("a name") }),
        ("pb/lab/nxt-7/cmd", FleetKey::Command { robot: robot() }),
        ("pb/lab/nxt-7/state", FleetKey::State { robot: robot() }),
        ("pb/lab/@own/nxt-7/4294967295/north-00000000000000ab", FleetKey::Ownership { robot: robot(), token }),
        ("pb/lab/@station/north-00000000000000ab", FleetKey::Station(station())),
    ]
}

#[test]
fn every_key_has_one_text() {
    for (text, key) in examples() {
        assert_eq!(keys().build(&key), text);
        assert_eq!(keys().parse(text), Ok(key));
    }
}

#[test]
fn what_is_no_key_is_refused_with_its_reason() {
    let cases = [
        ("", KeyError::OtherFleet),
        ("pb", KeyError::OtherFleet),
        ("pb/hall/nxt-7/est", KeyError::OtherFleet),
        ("PB/lab/nxt-7/est", KeyError::OtherFleet),
        ("pb/lab", KeyError::Unknown),
        ("pb/lab/nxt-7", KeyError::Unknown),
        ("pb/lab/nxt-7/est/", KeyError::Unknown),
        ("pb/lab/nxt-7/EST", KeyError::Unknown),
        ("pb/lab/@own/nxt-7/1/north-00000000000000ab/more", KeyError::Unknown),
        ("pb/lab//est", KeyError::Name(NameError::Empty)),
        ("pb/lab/*/est", KeyError::Name(NameError::Character('*'))),
        ("pb/lab/@own/raw/usb0", KeyError::Name(NameError::Character('@'))),
        ("pb/lab/@own/nxt-7/0/north-00000000000000ab", KeyError::Epoch),
        ("pb/lab/@own/nxt-7/01/north-00000000000000ab", KeyError::Epoch),
        ("pb/lab/@own/nxt-7/+1/north-00000000000000ab", KeyError::Epoch),
        ("pb/lab/@own/nxt-7/4294967296/north-00000000000000ab", KeyError::Epoch),
        ("pb/lab/@own/nxt-7/1/north", KeyError::Name(NameError::Instance)),
        ("pb/lab/@station/north-00000000000000AB", KeyError::Name(NameError::Instance)),
    ];
    for (text, error) in cases {
        assert_eq!(keys().parse(text), Err(error), "{text}");
    }
}

#[test]
fn selectors_have_a_wildcard_for_each_name() {
    assert_eq!(keys().all_tokens(), "pb/lab/@own/*/*/*");
    assert_eq!(keys().all_stations(), "pb/lab/@station/*");
    assert_eq!(keys().all_estimates(), "pb/lab/*/est");
    assert_eq!(keys().all_states(), "pb/lab/*/state");
}

proptest! {
    #[test]
    fn any_text_is_refused_or_is_the_text_of_its_key(text in "(pb/lab/)?[a-z0-9@/*.é-]{0,40}") {
        if let Ok(key) = keys().parse(&text) {
            prop_assert_eq!(keys().build(&key), text);
        }
    }
}
