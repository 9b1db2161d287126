//! CRC_EXTRA and the greatest length of every message of every dialect, for the framer.
//!
//! Built once from the generated types, so that it always agrees with them. An unknown id is `None`, never CRC_EXTRA 0:
//! COMPONENT_INFORMATION (395) has CRC_EXTRA 0.

use std::sync::LazyLock;

use mavlink::dialects::common;
use mavlink_core::{MavlinkVersion, Message};

use super::generated::posebridge;
use super::payload::MAX_PAYLOAD;

/// Number of ids in a lookup page: those of the standard dialects lie on four, ours on one.
const PAGE: usize = 256;
/// Ids have 24 bits.
const PAGES: usize = 1 << 16;

/// The messages of all dialects.
pub(crate) static CATALOGUE: LazyLock<MessageCatalogue> = LazyLock::new(|| {
    let foreign = FOREIGN_MESSAGES.iter().map(|message| (message.id, message.layout));
    MessageCatalogue::build(supported_messages().chain(foreign))
});

/// Messages without generated types, by rising id, so that they are verified, counted and named: the types of these dialects would double
/// the build time. A sender may use another version of such a dialect; what fails here is forwarded like a message of no dialect.
///
/// # Sources
/// `all.xml` and `ardupilotmega.xml` of the MAVLink project with everything that they include (upstream commit
/// 19795337), less the messages of `common.xml`; seeds and lengths by pymavlink 2.4.50's `mavparse`. Where pymavlink's
/// own `ardupilotmega` dialect has a message too, its seed is the same.
const FOREIGN_TABLE: &str = include_str!("foreign_messages.csv");
static FOREIGN_MESSAGES: LazyLock<Vec<ForeignMessage>> =
    LazyLock::new(|| FOREIGN_TABLE.lines().filter_map(ForeignMessage::parse).collect());

#[derive(Clone, Copy, Debug)]
struct ForeignMessage {
    id: u32,
    layout: MessageLayout,
    name: &'static str,
}

impl ForeignMessage {
    /// `None` for the heading of the table.
    fn parse(row: &'static str) -> Option<Self> {
        let [id, crc_extra, max_len_v1, max_len_v2, name] = row.split(',').collect::<Vec<_>>()[..] else {
            return None;
        };
        let layout = MessageLayout {
            crc_extra: crc_extra.parse().ok()?,
            max_len_v1: max_len_v1.parse().ok()?,
            max_len_v2: max_len_v2.parse().ok()?,
            is_foreign: true,
        };
        Some(Self { id: id.parse().ok()?, layout, name })
    }
}

/// The name of a message in its definition, also in foreign dialects; `None` for an unknown id.
pub fn message_name(id: u32) -> Option<&'static str> {
    let standard = || common::MavMessage::default_message_from_id(id).map(|message| message.message_name());
    let own = || posebridge::MavMessage::default_message_from_id(id).map(|message| message.message_name());
    let foreign = || {
        let index = FOREIGN_MESSAGES.binary_search_by_key(&id, |message| message.id);
        index.ok().and_then(|index| FOREIGN_MESSAGES.get(index))
    };
    standard().or_else(own).or_else(|| foreign().map(|message| message.name))
}

/// Whether a message belongs to a dialect of the MAVLink project, and not to ours or to none.
pub(crate) fn is_stock_message(id: u32) -> bool {
    CATALOGUE.layout(id).is_some() && !posebridge::MavMessage::all_ids().contains(&id)
}

/// The id of the message with this name, in any dialect; case-sensitive.
pub fn message_id_named(name: &str) -> Option<u32> {
    let standard = common::MavMessage::message_id_from_name(name);
    let foreign = || Some(FOREIGN_MESSAGES.iter().find(|message| message.name == name)?.id);
    standard.or_else(|| posebridge::MavMessage::message_id_from_name(name)).or_else(foreign)
}

fn supported_messages() -> impl Iterator<Item = (u32, MessageLayout)> {
    let standard =
        common::MavMessage::all_ids().iter().filter_map(|&id| Some((id, measure_layout::<common::MavMessage>(id)?)));
    let own = posebridge::MavMessage::all_ids()
        .iter()
        .filter_map(|&id| Some((id, measure_layout::<posebridge::MavMessage>(id)?)));
    standard.chain(own)
}

/// The checksum seed and the lengths of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MessageLayout {
    /// Seed of the checksum, from the message's definition.
    pub(crate) crc_extra: u8,
    /// Payload length without extension fields.
    pub(crate) max_len_v1: u8,
    /// Payload length with extension fields.
    pub(crate) max_len_v2: u8,
    /// Whether it belongs to neither common.xml nor our own dialect.
    pub(crate) is_foreign: bool,
}

/// Every message that this station can verify.
#[derive(Debug)]
pub(crate) struct MessageCatalogue {
    /// The page of layouts for the ids from `PAGE` times the index; page 0 is empty.
    pages: Vec<u8>,
    layouts: Vec<[Option<MessageLayout>; PAGE]>,
}

impl MessageCatalogue {
    fn build(shapes: impl Iterator<Item = (u32, MessageLayout)>) -> Self {
        let mut catalogue = Self { pages: vec![0; PAGES], layouts: vec![[None; PAGE]] };
        for (id, shape) in shapes {
            let id = id as usize;
            if catalogue.pages[id / PAGE] == 0 {
                catalogue.pages[id / PAGE] = catalogue.layouts.len() as u8;
                catalogue.layouts.push([None; PAGE]);
            }
            let page = usize::from(catalogue.pages[id / PAGE]);
            catalogue.layouts[page][id % PAGE] = Some(shape);
        }
        catalogue
    }

    /// The layout of the message `id`; `None` when it is in no dialect.
    #[inline]
    pub(crate) fn layout(&self, id: u32) -> Option<MessageLayout> {
        let id = id as usize;
        let page = *self.pages.get(id / PAGE)?;
        self.layouts.get(usize::from(page))?[id % PAGE]
    }
}

fn measure_layout<M: Message>(id: u32) -> Option<MessageLayout> {
    let message = M::default_message_from_id(id)?;
    Some(MessageLayout {
        crc_extra: M::extra_crc(id),
        max_len_v1: written_length(&message, MavlinkVersion::V1),
        max_len_v2: written_length(&message, MavlinkVersion::V2),
        is_foreign: false,
    })
}

/// Number of bytes that a message writes. MAVLink 2's own result excludes trailing zeros, so the written bytes are
/// detected as those that do not depend on the buffer's previous content.
fn written_length<M: Message>(message: &M, version: MavlinkVersion) -> u8 {
    let mut over_zeros = [0x00; MAX_PAYLOAD];
    let mut over_ones = [0xFF; MAX_PAYLOAD];
    message.ser(version, &mut over_zeros);
    message.ser(version, &mut over_ones);
    let length = over_zeros.iter().zip(&over_ones).take_while(|(a, b)| a == b).count();
    length as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_message_is_found_and_none_between_them() {
        let foreign = FOREIGN_MESSAGES.iter().map(|message| message.id);
        let known: BTreeSet<u32> = supported_messages().map(|(id, _)| id).chain(foreign).collect();
        assert!(known.len() > 300);
        for id in (0..70_000).chain([0x00FF_FFFF, u32::MAX]) {
            assert_eq!(CATALOGUE.layout(id).is_some(), known.contains(&id), "{id}");
        }
        for (id, shape) in supported_messages() {
            assert_eq!(CATALOGUE.layout(id), Some(shape), "{id}");
        }
    }

    /// Lengths and seeds as the MAVLink project publishes them (minimal.xml, common.xml).
    #[test]
    fn published_lengths_and_seeds_are_met() {
        for (id, crc_extra, max_len_v1, max_len_v2) in [
            (0, 50, 9, 9),
            (26, 170, 22, 24),
            (76, 152, 33, 33),
            (77, 143, 3, 10),
            (102, 158, 32, 117),
            (111, 34, 16, 18),
            (331, 91, 230, 233),
            (9000, 113, 137, 137),
        ] {
            let expected = MessageLayout { crc_extra, max_len_v1, max_len_v2, is_foreign: false };
            assert_eq!(CATALOGUE.layout(id), Some(expected), "message {id}");
        }
    }

    #[test]
    fn a_seed_of_zero_is_not_an_unknown_message() {
        assert_eq!(CATALOGUE.layout(395).map(|shape| shape.crc_extra), Some(0));
        assert_eq!(CATALOGUE.layout(396 + 40_000), None);
        assert_eq!(CATALOGUE.layout(u32::MAX), None);
    }

    #[test]
    fn foreign_messages_shadow_none_of_ours_and_are_sorted_by_id() {
        assert_eq!(FOREIGN_MESSAGES.len(), FOREIGN_TABLE.lines().count() - 1);
        assert!(FOREIGN_MESSAGES.is_sorted_by(|one, next| one.id < next.id));
        for message in FOREIGN_MESSAGES.iter() {
            assert_eq!(CATALOGUE.layout(message.id), Some(message.layout), "{}", message.name);
        }
        // RADIO of ArduPilot, as ardupilotmega.xml defines it.
        let radio = CATALOGUE.layout(166).unwrap();
        assert_eq!((radio.crc_extra, radio.max_len_v1), (21, 9));
    }

    #[test]
    fn every_message_that_can_be_verified_has_a_name() {
        assert_eq!(message_name(0), Some("HEARTBEAT"));
        assert_eq!(message_name(166), Some("RADIO"));
        assert_eq!(message_name(42_102), Some("PB_PLANAR_POSE"));
        assert_eq!(message_name(9_999_999), None);
        assert_eq!(message_id_named("heartbeat"), None);
        for id in 0..100_000 {
            let name = message_name(id);
            assert_eq!(CATALOGUE.layout(id).is_some(), name.is_some(), "{id}");
            assert_eq!(name.and_then(message_id_named), name.map(|_| id), "{id}");
        }
    }

    #[test]
    fn no_message_of_ours_has_a_seed_of_zero_or_shadows_a_standard_one() {
        for &id in posebridge::MavMessage::all_ids() {
            let shape = CATALOGUE.layout(id).unwrap();
            assert_ne!(shape.crc_extra, 0, "message {id}");
            assert!(!common::MavMessage::all_ids().contains(&id), "message {id}");
        }
    }
}
