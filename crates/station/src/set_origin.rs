//! SET_GPS_GLOBAL_ORIGIN: a ground station says where on the Earth the arena lies.
//!
//! Only links for ground stations are heard: on the link of a robot any neighbour could move the arena. A vehicle with an autopilot has an
//! origin of its own, which is not that of the arena.
//!
//! Source: common.xml, SET_GPS_GLOBAL_ORIGIN: the answer is GPS_GLOBAL_ORIGIN, whether the origin has changed or not.

use posebridge_protocol::message::{Message, SetGlobalOrigin};
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Command, GeodeticOrigin, Priority, RobotId, SensorId, severity};

use crate::sessions::SenderRole;
use crate::station::Station;
use crate::vehicle_status::global_reference;

impl Station {
    /// Sets the origin of all robots: they share the arena. Each vehicle that is addressed answers, else the station itself.
    pub(crate) fn handle_set_origin(&mut self, from: Endpoint, request: &SetGlobalOrigin) {
        let Endpoint { link, peer } = from;
        let Some(vehicles) = self.sessions.vehicles(link) else {
            return;
        };
        let now = self.time.now;
        let robots = self.robots.detected().iter();
        let addressed: Vec<_> = robots
            .filter(|robot| request.system.0 == 0 || request.system == robot.vehicle_address.system)
            .map(|robot| robot.id)
            .filter(|robot| vehicles.is_described_here(now, *robot))
            .collect();
        let is_for_station = request.system.0 == 0 || request.system == self.config.own_address.system;
        if addressed.is_empty() && !is_for_station {
            return;
        }
        let answers = addressed.len().max(1);
        if !self.links.get_mut(&link).is_some_and(|link| link.charge_request(now, peer, answers)) {
            return;
        }
        match GeodeticOrigin::new(request.position, request.altitude) {
            Some(origin) if self.config.origin == Some(origin) => {}
            Some(origin) => self.set_origin(origin),
            None => self.report_own_text(severity::WARNING, "origin not set: that is no point on the Earth".to_owned()),
        }
        let Some(origin) = self.config.origin else {
            return;
        };
        let reply = Message::GlobalOrigin(global_reference(now, &origin));
        if addressed.is_empty() {
            self.transmitter().send_session_message(link, SenderRole::Station, &reply);
        }
        for robot in addressed {
            self.transmitter().send_as(link, SenderRole::Vehicle(robot), &reply, Priority::Command);
        }
    }

    fn set_origin(&mut self, origin: GeodeticOrigin) {
        let before = self.config.origin.replace(origin);
        for robot in self.robots.all_mut() {
            robot.extractor.origin = Some(origin);
        }
        let [latitude, longitude] =
            [origin.point().latitude, origin.point().longitude].map(|angle| angle.0.to_degrees());
        self.report_own_text(severity::NOTICE, format!("origin set: {latitude:.7}, {longitude:.7}"));
        if before.is_none() {
            return;
        }
        // Satellites have placed them in the arena as it lay before.
        let robots = self.robots.detected().iter();
        let placed: Vec<RobotId> =
            robots.filter(|robot| robot.sensor_health.was_used(SensorId::GNSS)).map(|robot| robot.id).collect();
        for robot in placed {
            self.handle_robot_command(robot, Command::ResetPose);
        }
    }
}
