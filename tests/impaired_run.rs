//! Brick and station over a bad link in virtual time: the same every time, and the station is worth having even so.
#![expect(clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

use posebridge::config::Config;
use posebridge::station::run_report::{SimulationTruth, errors};
use posebridge::virtual_station::{self, VirtualLink, VirtualRun};
use posebridge_sim::impairment::{LinkKind, LinkProfile, PROFILES};
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_station::Station;
use posebridge_telemetry::{Input, LinkState, Output, PeerId, TimeDelta, Timestamp};

fn scenario() -> Scenario {
    Scenario::bundled("square").unwrap().with_seed(3).with_steering(Steering::Estimate)
}

fn drive(link: &VirtualLink) -> VirtualRun {
    let scenario = scenario();
    let config = Config::default().with_tag_of(&scenario);
    virtual_station::run_over_link(scenario, config.station_config().unwrap(), link).unwrap()
}

fn bundled(name: &str) -> VirtualLink {
    VirtualLink { profile: LinkProfile::bundled(name).unwrap(), seed: 5, ..VirtualLink::default() }
}

#[test]
fn the_same_seed_gives_the_same_run_bit_for_bit_and_another_does_not() {
    let link = bundled("harsh");
    let (first, again) = (drive(&link), drive(&link));
    assert_eq!(first.simulation.truth(), again.simulation.truth());
    assert_eq!(first.collector.estimates.items(), again.collector.estimates.items());
    assert_eq!(first.simulation.received_estimates(), again.simulation.received_estimates());
    assert_eq!(first.link, again.link);
    let other = drive(&VirtualLink { seed: 6, ..link });
    assert_ne!(first.link, other.link);
    assert_ne!(first.simulation.truth(), other.simulation.truth());
}

#[test]
fn the_clean_link_is_no_link() {
    let with = drive(&VirtualLink::default());
    let without = hand_in_hand();
    assert_eq!(with.simulation.truth(), without.truth());
    assert_eq!(with.simulation.received_estimates(), without.received_estimates());
    assert_eq!(with.link.to_station.bytes_lost(), 0);
    assert!(with.link.to_station.bytes_delivered > 10_000);
}

#[test]
fn over_every_bundled_link_the_lap_ends_and_the_books_balance() {
    for (name, _) in PROFILES {
        let run = drive(&bundled(name));
        assert!(run.simulation.is_finished(), "{name}");
        let (estimate, odometry) = errors(&run.collector, &SimulationTruth::from_simulation(&run.simulation));
        println!(
            "{name}: estimate {:.1} mm, odometry {:.1} mm, {} outages, {} of {} bytes lost",
            estimate.position_rms_m.unwrap() * 1e3,
            odometry.position_rms_m.unwrap() * 1e3,
            run.link.outages,
            run.link.to_station.bytes_lost(),
            run.link.to_station.bytes_offered,
        );
        assert!(!run.simulation.received_estimates().is_empty(), "{name}");
        for counters in [run.link.to_station, run.link.to_brick] {
            assert_eq!(
                counters.bytes_offered,
                counters.bytes_delivered + counters.bytes_lost() + counters.bytes_on_the_way,
                "{name}"
            );
        }
    }
}

#[test]
fn an_estimate_is_as_much_older_at_the_brick_as_the_link_is_slower() {
    let median_age = |extra_delay_ms| {
        let run = drive(&VirtualLink { extra_delay_ms, ..VirtualLink::default() });
        let estimates = run.simulation.received_estimates();
        let mut ages: Vec<TimeDelta> = estimates.iter().map(posebridge_sim::ReceivedEstimate::age).collect();
        ages.sort_unstable();
        ages[ages.len() / 2].as_millis_f64()
    };
    let (at_once, late) = (median_age(0.0), median_age(40.0));
    println!("median age {at_once:.2} ms, with 40 ms each way {late:.2} ms");
    assert!((0.0..2.0).contains(&at_once), "{at_once}");
    assert!((late - at_once - 80.0).abs() < 2.0, "{late}");
}

#[test]
fn loss_delay_and_skew_of_the_sweep_are_what_was_asked_for() {
    let run = drive(&VirtualLink {
        profile: LinkProfile { kind: LinkKind::Datagram, ..LinkProfile::default() },
        seed: 1,
        extra_loss: 0.2,
        extra_delay_ms: 30.0,
        brick_skew_ppm: Some(2_000.0),
    });
    let counters = run.link.to_station;
    let share = counters.bytes_lost_alone as f64 / counters.bytes_offered as f64;
    assert!((share - 0.2).abs() < 0.05, "{share}");
    let last = run.simulation.truth().last().unwrap();
    let first = run.simulation.truth().first().unwrap();
    let gained_ppm =
        ((last.brick_time - first.brick_time).as_secs_f64() / (last.sim_time - first.sim_time).as_secs_f64() - 1.0)
            * 1e6;
    assert!((gained_ppm - 2_000.0).abs() < 1.0, "{gained_ppm}");
    let health = run.collector.links.values().next().unwrap().health;
    assert!(health.frames_lost > 50, "{}", health.frames_lost);
    assert!(health.round_trip.unwrap() >= TimeDelta::from_millis(60));
    // The robot steers by what reached it: its belief stays with the truth all the same.
    let worst_m = run
        .simulation
        .truth()
        .iter()
        .map(|sample| sample.onboard_estimate.origin().distance(sample.pose.origin()).0)
        .fold(0.0, f64::max);
    println!("belief off by {:.1} mm at most", worst_m * 1e3);
    assert!(worst_m < 0.06, "{worst_m}");
}

/// The same drive with nothing between brick and station: each takes what the other says at once.
fn hand_in_hand() -> Simulation {
    let scenario = scenario();
    let config = Config::default().with_tag_of(&scenario).station_config().unwrap();
    let link = config.links.first().unwrap().id;
    let mut station = Station::new(config, Timestamp::ZERO).unwrap();
    let mut simulation = Simulation::new(scenario);
    let mut handle = |now, input: &Input, simulation: &mut Simulation| {
        station.handle(now, input);
        while let Some(output) = station.poll() {
            if let Output::Transmit { bytes, .. } = output {
                simulation.receive(&bytes);
            }
        }
        station.deadline()
    };
    let state = LinkState::Up;
    let mut deadline = handle(Timestamp::ZERO, &Input::Link { link, state }, &mut simulation);
    let mut ends_at = None;
    while ends_at.is_none_or(|end| simulation.elapsed() < end) {
        simulation.step();
        let now = Timestamp::ZERO + simulation.elapsed();
        while let Some(bytes) = simulation.poll() {
            let peer = PeerId::default();
            deadline = handle(now, &Input::Bytes { link, peer, bytes }, &mut simulation);
        }
        if deadline.is_some_and(|deadline| deadline <= now) {
            deadline = handle(now, &Input::Tick, &mut simulation);
        }
        if simulation.is_finished() && ends_at.is_none() {
            // The brick talks on for as long as it does in a virtual run.
            ends_at = Some(simulation.elapsed() + TimeDelta::from_millis(600));
        }
    }
    simulation
}
