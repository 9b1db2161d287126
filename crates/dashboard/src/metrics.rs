//! `/metrics`, in the text format of Prometheus: base units, one prefix, no time and no sequence number in a label.
//!
//! # Sources
//! Prometheus, "Exposition formats" 0.0.4 and "Metric and label naming".

use std::fmt::Write as _;

use posebridge_telemetry::{LinkCounter, LinkHealth, TimeDelta};

use crate::counters::{COUNTER_TABLE, ServerCounter, ServerCounters};
use crate::hub::Hub;
use crate::model::{EstimatePoint, FleetRobotRow, FleetState, RobotState};
use crate::views::robot_name;

pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

struct LinkMetric {
    name: &'static str,
    kind: &'static str,
    help: &'static str,
    read: fn(&LinkHealth) -> Option<f64>,
}

#[rustfmt::skip]
const LINK_METRICS: &[LinkMetric] = &[
    LinkMetric { name: "received_bytes_total", kind: "counter", help: "Bytes received.", read: |of| Some(of.bytes_in as f64) },
    LinkMetric { name: "sent_bytes_total", kind: "counter", help: "Bytes handed over for sending.", read: |of| Some(of.bytes_out as f64) },
    LinkMetric { name: "received_frames_total", kind: "counter", help: "Frames received whole.", read: |of| Some(of.frames_in as f64) },
    LinkMetric { name: "sent_frames_total", kind: "counter", help: "Frames sent.", read: |of| Some(of.frames_out as f64) },
    // A late frame is subtracted again, so this is no counter.
    LinkMetric { name: "lost_frames", kind: "gauge", help: "Frames missing in the sequence numbers.", read: |of| Some(of.frames_lost as f64) },
    LinkMetric { name: "kernel_drops_total", kind: "counter", help: LinkCounter::KERNEL_DROPS.help, read: |of| Some(of.port.kernel_drops as f64) },
    LinkMetric { name: "flood_drops_total", kind: "counter", help: LinkCounter::FLOOD_DROPS.help, read: |of| Some(of.port.flood_drops as f64) },
    LinkMetric { name: "excess_requests_total", kind: "counter", help: LinkCounter::EXCESS_REQUESTS.help, read: |of| Some(of.excess_requests as f64) },
    LinkMetric { name: "checksum_errors_total", kind: "counter", help: "Frames whose checksum was wrong.", read: |of| Some(of.checksum_errors as f64) },
    LinkMetric { name: "garbage_bytes_total", kind: "counter", help: "Bytes outside every frame.", read: |of| Some(of.garbage_bytes as f64) },
    LinkMetric { name: "stalls_total", kind: "counter", help: "Frames whose bytes stopped coming.", read: |of| Some(of.timeouts as f64) },
    LinkMetric { name: "dropped_frames_total", kind: "counter", help: "Outgoing frames dropped.", read: |of| Some(of.drops_out as f64) },
    LinkMetric { name: "reconnects_total", kind: "counter", help: "Times the link came up again.", read: |of| Some(of.reconnects as f64) },
    LinkMetric { name: "queued_frames", kind: "gauge", help: "Frames that wait to be sent.", read: |of| Some(f64::from(of.port.queued_frames)) },
    LinkMetric { name: "round_trip_seconds", kind: "gauge", help: "Round-trip time of the last answered time request.", read: |of| of.round_trip.map(TimeDelta::as_secs_f64) },
    LinkMetric { name: "clock_uncertainty_seconds", kind: "gauge", help: "How far a converted stamp may be off.", read: |of| of.clock_uncertainty.map(TimeDelta::as_secs_f64) },
];

/// A number of a robot's last estimate, with session time in seconds.
struct EstimateMetric {
    name: &'static str,
    help: &'static str,
    read: fn(&EstimatePoint, f64) -> Option<f64>,
}

#[rustfmt::skip]
const ESTIMATE_METRICS: &[EstimateMetric] = &[
    EstimateMetric { name: "estimate_resets", help: "Jumps of the estimate that were no motion, modulo 256.", read: |of, _| Some(f64::from(of.reset_counter)) },
    EstimateMetric { name: "position_ellipse_metres", help: "Half the longer axis of the 95 % ellipse.", read: |of, _| of.major_m.get() },
    EstimateMetric { name: "heading_sigma_radians", help: "One standard deviation of the heading.", read: |of, _| of.heading_sigma_rad.get() },
    EstimateMetric { name: "estimate_age_seconds", help: "Time since the last estimate.", read: |of, now_s| Some(age_s(of, now_s)) },
    EstimateMetric { name: "fix_age_seconds", help: "Time since the last fix that was used.", read: |of, now_s| of.fix_age_s.get().map(|then_s| then_s + age_s(of, now_s)) },
];

fn age_s(estimate: &EstimatePoint, now_s: f64) -> f64 {
    (now_s - estimate.t_s).max(0.0)
}

pub(crate) fn page(hub: &Hub, counts: &ServerCounters) -> String {
    counts.set(ServerCounter::PointsDropped, hub.dropped());
    let mut page = String::with_capacity(8_192);
    robots(&mut page, hub, counts);
    latency(&mut page, hub);
    stalls(&mut page, hub);
    links(&mut page, hub);
    server(&mut page, counts);
    page
}

fn robots(page: &mut String, hub: &Hub, counts: &ServerCounters) {
    let name = "posebridge_observations_total";
    head(page, name, "counter", "Observations by what became of them.");
    for ((sensor, kind, verdict), count) in &hub.outcome_counts {
        let sensor = sensor.name();
        line(page, format_args!("{name}{{sensor=\"{sensor}\",kind=\"{kind}\",verdict=\"{verdict}\"}} {count}"));
    }
    let state = hub.state(counts);
    let name = "posebridge_robot_info";
    head(page, name, "gauge", "1 for each robot, with its configured name.");
    for RobotState { id, name: called, .. } in &state.robots {
        let called = escape(called.as_deref().unwrap_or_default());
        line(page, format_args!("{name}{{robot=\"{id}\",name=\"{called}\"}} 1"));
    }
    let name = "posebridge_robot_estimates_total";
    head(page, name, "counter", "Estimates of each robot.");
    for (robot, count) in &hub.estimate_counts {
        line(page, format_args!("{name}{{robot=\"{}\"}} {count}", robot_name(*robot)));
    }
    for metric in ESTIMATE_METRICS {
        let name = format!("posebridge_{}", metric.name);
        head(page, &name, "gauge", metric.help);
        for robot in &state.robots {
            let estimate = robot.estimate.as_ref();
            if let Some(value) = estimate.and_then(|estimate| (metric.read)(estimate, state.now_s)) {
                let id = &robot.id;
                line(page, format_args!("{name}{{robot=\"{id}\"}} {value}"));
            }
        }
    }
}

/// Escapes a label value; a name may be any text.
fn escape(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

fn latency(page: &mut String, hub: &Hub) {
    let name = "posebridge_estimate_latency_seconds";
    head(page, name, "histogram", "From an observation's arrival to its estimate's departure.");
    for (end, count) in hub.latency.buckets() {
        let end_s = end as f64 / 1e6;
        line(page, format_args!("{name}_bucket{{le=\"{end_s}\"}} {count}"));
    }
    let (sum_s, count) = (hub.latency.sum.as_secs_f64(), hub.latency.count);
    line(page, format_args!("{name}_bucket{{le=\"+Inf\"}} {count}"));
    line(page, format_args!("{name}_sum {sum_s}"));
    line(page, format_args!("{name}_count {count}"));
    let name = "posebridge_estimates_total";
    head(page, name, "counter", "Estimates.");
    line(page, format_args!("{name} {count}"));
}

fn stalls(page: &mut String, hub: &Hub) {
    let name = "posebridge_loop_stalls_total";
    head(page, name, "counter", "Times that the station stood still for longer than a second.");
    line(page, format_args!("{name} {}", hub.loop_stalls));
}

fn links(page: &mut String, hub: &Hub) {
    for metric in LINK_METRICS {
        let name = format!("posebridge_link_{}", metric.name);
        head(page, &name, metric.kind, metric.help);
        for (link, health) in &hub.links {
            if let Some(value) = (metric.read)(health) {
                line(page, format_args!("{name}{{link=\"{link}\"}} {value}"));
            }
        }
    }
}

/// A counter of estimates that the owner of a robot has published.
struct FleetMetric {
    name: &'static str,
    help: &'static str,
    read: fn(&FleetRobotRow) -> u64,
}

#[rustfmt::skip]
const FLEET_METRICS: &[FleetMetric] = &[
    FleetMetric { name: "received_estimates_total", help: "Estimates of other stations that have arrived.", read: |of| of.received },
    FleetMetric { name: "lost_estimates_total", help: "Estimates of other stations that have not arrived.", read: |of| of.lost },
    FleetMetric { name: "stale_estimates_total", help: "Estimates of stations that no longer owned the robot.", read: |of| of.stale },
];

/// The part of the page about the fleet; it follows the rest.
pub(crate) fn fleet_part(fleet: &FleetState) -> String {
    let mut part = String::new();
    for metric in FLEET_METRICS {
        let name = format!("posebridge_fleet_{}", metric.name);
        head(&mut part, &name, "counter", metric.help);
        for robot in &fleet.robots {
            let (label, count) = (escape(&robot.name), (metric.read)(robot));
            line(&mut part, format_args!("{name}{{robot=\"{label}\"}} {count}"));
        }
    }
    part
}

fn server(page: &mut String, counts: &ServerCounters) {
    let mut last = "";
    for row in COUNTER_TABLE {
        let name = format!("posebridge_dashboard_{}", row.name);
        if row.name != last {
            head(page, &name, row.kind, row.help);
            last = row.name;
        }
        let count = counts.value(row.count);
        match row.reason {
            Some(reason) => line(page, format_args!("{name}{{reason=\"{reason}\"}} {count}")),
            None => line(page, format_args!("{name} {count}")),
        }
    }
}

fn head(page: &mut String, name: &str, kind: &str, help: &str) {
    line(page, format_args!("# HELP {name} {help}"));
    line(page, format_args!("# TYPE {name} {kind}"));
}

fn line(page: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a String cannot fail.
    let _ = writeln!(page, "{text}");
}
