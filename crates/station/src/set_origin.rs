//! SET_GPS_GLOBAL_ORIGIN: a ground station says where on the Earth the arena lies.
//!
//! Source: common.xml, SET_GPS_GLOBAL_ORIGIN: the answer is GPS_GLOBAL_ORIGIN, whether the origin has changed or not.

use posebridge_protocol::message::{Message, SetGlobalOrigin};
use posebridge_telemetry::{GeodeticOrigin, LinkId, Priority, severity};

use crate::sessions::SenderRole;
use crate::station::Station;
use crate::vehicle_status::global_reference;

impl Station {
    /// Sets the origin of all robots: they share the arena.
    pub(crate) fn handle_set_origin(&mut self, link: LinkId, request: &SetGlobalOrigin) {
        let robots = self.robots.detected().iter();
        let addressed: Vec<_> = robots
            .filter(|robot| request.system.0 == 0 || request.system == robot.vehicle_address.system)
            .map(|robot| robot.id)
            .collect();
        // Another system has an origin of its own.
        if addressed.is_empty() && request.system != self.config.own_address.system {
            return;
        }
        match GeodeticOrigin::new(request.position, request.altitude) {
            Some(origin) => {
                self.config.origin = Some(origin);
                for robot in self.robots.all_mut() {
                    robot.extractor.origin = Some(origin);
                }
                let [latitude, longitude] =
                    [origin.point().latitude, origin.point().longitude].map(|angle| angle.0.to_degrees());
                self.report_own_text(severity::NOTICE, format!("origin set: {latitude:.7}, {longitude:.7}"));
            }
            None => self.report_own_text(severity::WARNING, "origin not set: that is no point on the Earth".to_owned()),
        }
        let Some(origin) = self.config.origin else {
            return;
        };
        let reply = Message::GlobalOrigin(global_reference(self.time.now, &origin));
        for robot in addressed {
            self.transmitter().send_as(link, SenderRole::Vehicle(robot), &reply, Priority::Command);
        }
    }
}
