//! Jumps of the space that an observer reports in: a tracker that has found itself anew counts them.
//!
//! Its fixes after a jump cannot be compared with the earlier estimate: neither is the robot's motion. The estimate goes to the
//! observer's new space with the first fix of it, as a counted reset. Only a fix that follows one of the same observer shows a jump.

use posebridge_telemetry::SensorId;

/// Most observers that are followed; jumps of further ones are not noticed, and the gate tests their fixes like all others.
const MAX_OBSERVERS: usize = 8;

/// The counters of all observers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ObserverFrames {
    counters: [Option<(SensorId, u8)>; MAX_OBSERVERS],
}

impl ObserverFrames {
    /// Whether the space of an observer has jumped since its last fix; takes note of its counter.
    pub fn has_jumped(&mut self, sensor: SensorId, counter: u8) -> bool {
        let slot = self.counters.iter_mut().find(|slot| slot.is_none_or(|(known, _)| known == sensor));
        let Some(slot) = slot else { return false };
        let before = slot.replace((sensor, counter));
        before.is_some_and(|(_, before)| before != counter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_a_counter_that_changed_and_each_observer_has_its_own() {
        let mut spaces = ObserverFrames::default();
        let camera = SensorId::camera(0);
        let other = SensorId::camera(1);
        let told = [(camera, 3), (camera, 3), (other, 7), (camera, 4), (camera, 4), (other, 7), (camera, 3)];
        let jumped = told.map(|(sensor, counter)| spaces.has_jumped(sensor, counter));
        assert_eq!(jumped, [false, false, false, true, false, false, true]);
    }

    #[test]
    fn one_observer_too_many_is_not_followed() {
        let mut spaces = ObserverFrames::default();
        for id in 0..9 {
            assert!(!spaces.has_jumped(SensorId(id), 0));
        }
        assert!(!spaces.has_jumped(SensorId(8), 1));
        assert!(spaces.has_jumped(SensorId(7), 1));
    }
}
