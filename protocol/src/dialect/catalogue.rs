//! Every message of every dialect by its id: CRC_EXTRA and the greatest length for the framer, and its definition.
//!
//! Built once from the definitions; a test compares them with the generated types. An unknown id is `None`, never CRC_EXTRA 0:
//! COMPONENT_INFORMATION (395) has CRC_EXTRA 0.

use std::sync::LazyLock;

use super::definitions::{MessageDefinition, MessageLayout, definitions};
use super::generated::posebridge;

/// Number of ids in a lookup page: those of the standard dialects lie on four, ours on one.
const PAGE: usize = 256;
/// Ids have 24 bits.
const PAGES: usize = 1 << 16;

/// The messages of all dialects. A sender may use another version of a foreign one; what fails here is forwarded like a message of no dialect.
pub(crate) static CATALOGUE: LazyLock<MessageCatalogue> =
    LazyLock::new(|| MessageCatalogue::build(definitions().iter().map(|message| (message.id, message.layout))));

/// Where the definition of the message `id` stands in [`definitions`]; `None` when it is in no dialect.
pub fn definition_index(id: u32) -> Option<usize> {
    CATALOGUE.index(id)
}

/// The definition of the message `id`; `None` when it is in no dialect.
pub fn definition(id: u32) -> Option<&'static MessageDefinition> {
    definitions().get(definition_index(id)?)
}

/// The name of a message in its definition; `None` for an unknown id.
pub fn message_name(id: u32) -> Option<&'static str> {
    definition(id).map(|message| message.name)
}

/// Whether a message belongs to a dialect of the MAVLink project, and not to ours or to none.
pub fn is_stock_message(id: u32) -> bool {
    CATALOGUE.layout(id).is_some() && !posebridge::MavMessage::all_ids().contains(&id)
}

/// Every message that this station can verify.
#[derive(Debug)]
pub(crate) struct MessageCatalogue {
    /// The page of entries for the ids from `PAGE` times the index; page 0 is empty.
    pages: Vec<u8>,
    entries: Vec<[Option<CatalogueEntry>; PAGE]>,
}

#[derive(Clone, Copy, Debug)]
struct CatalogueEntry {
    layout: MessageLayout,
    /// In [`definitions`].
    index: u16,
}

impl MessageCatalogue {
    /// `shapes` in the order of [`definitions`].
    fn build(shapes: impl Iterator<Item = (u32, MessageLayout)>) -> Self {
        let mut catalogue = Self { pages: vec![0; PAGES], entries: vec![[None; PAGE]] };
        for (index, (id, layout)) in (0..).zip(shapes) {
            let id = id as usize;
            if catalogue.pages[id / PAGE] == 0 {
                catalogue.pages[id / PAGE] = catalogue.entries.len() as u8;
                catalogue.entries.push([None; PAGE]);
            }
            let page = usize::from(catalogue.pages[id / PAGE]);
            catalogue.entries[page][id % PAGE] = Some(CatalogueEntry { layout, index });
        }
        catalogue
    }

    /// The layout of the message `id`; `None` when it is in no dialect.
    #[inline]
    pub(crate) fn layout(&self, id: u32) -> Option<MessageLayout> {
        Some(self.entry(id)?.layout)
    }

    /// Of its definition in [`definitions`].
    pub(crate) fn index(&self, id: u32) -> Option<usize> {
        Some(usize::from(self.entry(id)?.index))
    }

    #[inline]
    fn entry(&self, id: u32) -> Option<&CatalogueEntry> {
        let id = id as usize;
        let page = *self.pages.get(id / PAGE)?;
        self.entries.get(usize::from(page))?[id % PAGE].as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::payload::MAX_PAYLOAD;
    use mavlink::dialects::common;
    use mavlink_core::{MavlinkVersion, Message};
    use std::collections::BTreeSet;

    /// The messages with generated types, as those measure.
    fn supported_messages() -> impl Iterator<Item = (u32, MessageLayout)> {
        let standard = common::MavMessage::all_ids()
            .iter()
            .filter_map(|&id| Some((id, measure_layout::<common::MavMessage>(id)?)));
        let own = posebridge::MavMessage::all_ids()
            .iter()
            .filter_map(|&id| Some((id, measure_layout::<posebridge::MavMessage>(id)?)));
        standard.chain(own)
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

    #[test]
    fn every_message_is_found_and_none_between_them() {
        let known: BTreeSet<u32> = definitions().iter().map(|message| message.id).collect();
        assert!(known.len() > 300);
        for id in (0..70_000).chain([0x00FF_FFFF, u32::MAX]) {
            assert_eq!(CATALOGUE.layout(id).is_some(), known.contains(&id), "{id}");
            assert_eq!(definition(id).map(|found| found.id), known.get(&id).copied());
        }
    }

    /// The generated code has another origin than the table.
    #[test]
    fn the_table_says_of_each_message_what_the_generated_types_say() {
        for (id, shape) in supported_messages() {
            assert_eq!(CATALOGUE.layout(id), Some(shape), "{id}");
        }
        let standard = common::MavMessage::all_ids()
            .iter()
            .map(|&id| (id, common::MavMessage::default_message_from_id(id).unwrap().message_name()));
        let own = posebridge::MavMessage::all_ids()
            .iter()
            .map(|&id| (id, posebridge::MavMessage::default_message_from_id(id).unwrap().message_name()));
        for (id, name) in standard.chain(own) {
            assert_eq!(message_name(id), Some(name));
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
    fn messages_of_foreign_dialects_are_marked() {
        // RADIO of ArduPilot, as ardupilotmega.xml defines it.
        let radio = CATALOGUE.layout(166).unwrap();
        assert_eq!((message_name(166), radio.crc_extra, radio.max_len_v1), (Some("RADIO"), 21, 9));
        assert!(radio.is_foreign && !CATALOGUE.layout(0).unwrap().is_foreign);
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
