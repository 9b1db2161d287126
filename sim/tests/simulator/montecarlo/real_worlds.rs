//! Scenarios of what real worlds do: mounted sensors, carried robots, bursts, patches, play and spinning wheels.

use posebridge_sim::montecarlo::{Drive, SCENARIOS, Scenario};
use posebridge_telemetry::{LandmarkId, ObservationKind};

use super::{DEGREE, assert_sigma, changed, fix_errors, fixes, rates, rms, true_turn_rad, wheel_angles};

/// A bundled scenario with further tables and keys.
fn extended(name: &str, more: &str, changes: &[(&str, &str)]) -> Scenario {
    let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
    let mut text = format!("{text}\n{more}");
    for (from, to) in changes {
        assert!(text.contains(from), "{name} has no `{from}`");
        text = text.replace(from, to);
    }
    Scenario::from_toml(&text).unwrap()
}

const ONE_LAP: (&str, &str) = ("laps = 4 ", "laps = 1 ");

#[test]
fn a_sensor_measures_from_where_it_sits_what_truly_stands_in_the_arena() {
    let sensors = "[landmarks]
        positions_m = [[4.0, 1.0], [-2.0, 2.0]]
        map_sigma_m = 0.1
        every_steps = 4
        delay_steps = 3
        range_sigma_m = 0.0
        range_share = 0.01
        bearing_sigma_deg = 1e-6
        field_of_view_deg = 180.0
        max_range_m = 4.0
        mounting = { x_m = { value = 0.3, sigma = 0.0 }, yaw_deg = { value = 90.0, sigma = 0.0 } }
        stamps = { offset_s = { value = 0.1, sigma = 0.0 }, skew_ppm = { value = 1000.0, sigma = 0.0 } }
        [beacons]
        positions_m = [[5.0, 5.0]]
        every_steps = 4
        delay_steps = 0
        range_sigma_m = 1e-6
        offset_sigma_m = 0.2
        max_range_m = 100.0
        [compass]
        every_steps = 4
        delay_steps = 0
        heading_sigma_deg = 1e-6
        mounting = { yaw_deg = { value = 0.0, sigma = 10.0 } }";
    let scenario = extended("no-camera", sensors, &[ONE_LAP]);
    let (mut relative, mut places, mut yaws, mut offsets) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for run in 0..40 {
        let drive = scenario.drive(run);
        assert_eq!(drive.truth, changed("no-camera", &[ONE_LAP]).drive(run).truth, "sensors change no truth");
        let mut place: Option<(f64, f64)> = None;
        for arrival in &drive.arrivals {
            let truth = drive.truth[arrival.measured_step];
            let (sin, cos) = truth.heading.rad().sin_cos();
            let late_s = (arrival.observation.stamp - drive.time_at(arrival.measured_step)).as_secs_f64();
            let measurement = arrival.observation.measurement;
            if let ObservationKind::Landmark { id: LandmarkId(0), range, bearing } = measurement {
                assert_eq!(arrival.step, arrival.measured_step + 3);
                let measured_s = arrival.measured_step as f64 * 0.05;
                assert!((late_s - 0.1 - 1e-3 * measured_s).abs() < 1e-6);
                assert!(bearing.0.abs() <= 90.0 * DEGREE + 1e-3 && range.0 < 4.2);
                // Back from the sensor, which looks to the left, to the post.
                let direction = truth.heading.rad() + 90.0 * DEGREE + bearing.0;
                let seen = (
                    truth.x.0 + 0.3 * cos + range.0 * direction.cos(),
                    truth.y.0 + 0.3 * sin + range.0 * direction.sin(),
                );
                let first = *place.get_or_insert(seen);
                relative.push(f64::hypot(seen.0 - first.0, seen.1 - first.1) / range.0);
                places.extend((relative.len() % 50 == 1).then_some(seen.0 - 4.0));
            } else if let ObservationKind::BeaconRange { range, .. } = measurement {
                offsets.push(range.0 - f64::hypot(5.0 - truth.x.0, 5.0 - truth.y.0));
            } else if let ObservationKind::CompassHeading(heading) = measurement {
                yaws.push((heading - truth.heading).0 / DEGREE);
            }
        }
    }
    assert!(relative.iter().all(|error| *error < 0.15) && rms(relative.iter().copied()) > 0.005);
    assert!(rms(places.iter().copied()) > 0.05 && rms(places.iter().copied()) < 0.2);
    let per_run = offsets.len() / 40;
    assert_sigma(rms(offsets.iter().step_by(per_run).copied()), 0.2, 40, "offset");
    assert!(offsets.chunks(per_run).all(|run| run.iter().all(|offset| (offset - run[0]).abs() < 1e-4)));
    assert_sigma(rms(yaws.iter().step_by(yaws.len() / 40).copied()), 10.0, 40, "yaw");
    let prior = scenario.drive(0).prior;
    assert_eq!(prior.calibration.landmark_delay_s.value, 0.1);
    assert_eq!((prior.noise.landmark_place_m, prior.arena_map.landmarks.len()), (0.1, 2));
}

#[test]
fn a_carried_robot_turns_without_its_wheels_and_goes_on_from_there() {
    let kidnaps = "[kidnaps]
        first_s = 10.0
        every_s = 1000.0
        carry_s = 2.0
        least_m = 1.0
        most_m = 1.0
        least_deg = 90.0
        most_deg = 90.0";
    for (carry, steps) in [("carry_s = 2.0", 40), ("carry_s = 0.0", 1)] {
        let scenario = extended(
            "kicks",
            kidnaps,
            &[("carry_s = 2.0", carry), ("probability_per_s = 0.15", "probability_per_s = 0")],
        );
        let plain = changed("kicks", &[("probability_per_s = 0.15", "probability_per_s = 0")]);
        for run in 0..5 {
            let (drive, plain) = (scenario.drive(run), plain.drive(run));
            let [landing] = drive.landings[..] else { panic!("{:?}", drive.landings) };
            let before = drive.truth[landing - steps];
            let after = drive.truth[landing];
            assert!((before.origin().distance(after.origin()).0 - 1.0).abs() < 0.02);
            assert!(((after.heading - before.heading).0.abs() - 90.0 * DEGREE).abs() < 0.02);
            // Carried, only the gyro turns; moved at once, not even that.
            let turned: f64 = rates(&drive)[landing - steps..landing].iter().map(|(_, rate)| rate * 0.05).sum();
            assert_eq!(turned.abs() > 80.0 * DEGREE, steps > 1, "{turned}");
            let still = &drive.wheel_turns[landing - steps..landing];
            assert_eq!(still.iter().all(|turn| turn.left.0 == 0.0 && turn.right.0 == 0.0), steps > 1);
            // The rest of the square is driven from the new pose, as long as without.
            let end = |drive: &Drive, from: usize| {
                drive.truth[from].origin().distance(drive.truth.last().unwrap().origin()).0
            };
            let paused = steps - steps % 40;
            assert_eq!(drive.truth.len(), plain.truth.len() + if steps > 1 { steps } else { 0 });
            assert!((end(&drive, landing) - end(&plain, landing - paused)).abs() < 0.05);
        }
    }
}

#[test]
fn a_burst_of_fixes_is_off_together_and_patches_and_bias_stay() {
    let exact =
        [("position_sigma_m = 0.005", "position_sigma_m = 1e-6"), ("delay_steps = 3 ", "delay_steps = 1 "), ONE_LAP];
    let with = |more: &str| {
        let text = format!("true_noise_factor = 1.0\n{more}\n#");
        extended("camera-10hz", "", &[exact[0], exact[1], exact[2], ("true_noise_factor = 1.0", &text)])
    };
    let errors = |more: &str, run| {
        let drive = with(more).drive(run);
        let taken: Vec<usize> = fixes(&drive).iter().map(|fix| fix.1).collect();
        (drive.clone(), taken.into_iter().zip(fix_errors(&drive)).collect::<Vec<_>>())
    };
    let burst = "bursts = { first_s = 20.0, every_s = 1000.0, lasts_s = 2.0, offset_m = 0.3, follows_robot = true }";
    let (_, burst) = errors(burst, 0);
    let far: Vec<_> = burst.iter().filter(|(_, error)| error.0.hypot(error.1) > 0.1).collect();
    assert!((20..=21).contains(&far.len()), "{}", far.len());
    for (_, error) in &far {
        assert!((error.0.hypot(error.1) - 0.3).abs() < 1e-4 && (error.0 - far[0].1.0).abs() < 1e-4);
    }
    let stands = "bursts = { first_s = 5.0, every_s = 1000.0, lasts_s = 2.0, offset_m = 0.3, follows_robot = false }";
    let (drive, stands) = errors(stands, 0);
    let shown: Vec<f64> = stands
        .iter()
        .filter(|(taken, _)| (121..=140).contains(taken))
        .map(|(taken, error)| drive.truth[*taken].x.0 + error.0)
        .collect();
    assert!(shown.len() > 5 && shown.iter().all(|x_m| (x_m - shown[0]).abs() < 1e-4), "{shown:?}");
    let bias: Vec<f64> = (0..100).map(|run| errors("bias_sigma_m = 0.02", run).1[0].1.0).collect();
    assert_sigma(rms(bias.iter().copied()), 0.02, 100, "bias");
    let (drive, patches) = errors("patches = { size_m = 0.5, sigma_m = 0.02 }", 0);
    // Wherever the edges lie, most neighbours have the same error, and a lap of 12 m meets many errors.
    let along: Vec<f64> = patches.iter().map(|(_, error)| error.0).collect();
    let steps = along.windows(2).filter(|pair| (pair[1] - pair[0]).abs() > 1e-4).count();
    assert!((15..along.len() / 4).contains(&steps), "{steps} of {}", along.len());
    assert!((drive.truth.len() > 1_000) && (0.01..0.03).contains(&rms(along)));
}

#[test]
fn encoders_count_play_and_spinning_wheels_that_do_not_move_the_robot() {
    let count = |scenario: &Scenario| {
        let drive = scenario.drive(1);
        let (last, turned) = (*wheel_angles(&drive).last().unwrap(), &drive.wheel_turns);
        let true_rad = turned.iter().map(|turn| turn.left.0 + turn.right.0).sum::<f64>();
        ((last.1 + last.2 - true_rad) / DEGREE, drive)
    };
    let spins = "[slip_bursts]
        first_s = 10.0
        every_s = 20.0
        counts = 50
        spread_steps = 10";
    let (extra, drive) = count(&extended("no-camera", spins, &[ONE_LAP]));
    assert_eq!(drive.truth, changed("no-camera", &[ONE_LAP]).drive(1).truth);
    let expected = 50.0 * drive.slip_bursts.len() as f64;
    assert!(drive.slip_bursts.len() > 2 && (extra - expected).abs() < 3.0, "{extra} of {expected}");
    // The last turn is to the left: the left wheel's play lies behind, the right one's ahead; at the start they lay anywhere.
    let (extra, _) = count(&changed("no-camera", &[ONE_LAP, ("tick_deg = 1.0", "backlash_deg = 6.0\ntick_deg = 1.0")]));
    assert!(extra.abs() <= 6.0 + 3.0, "{extra}");
}

#[test]
fn a_gyros_scale_is_drawn_once() {
    let scale = ("bias_walk_deg_per_s_sqrt_s = 0.01", "bias_walk_deg_per_s_sqrt_s = 0.01\nscale_sigma = 0.05");
    let scenario = changed("no-camera", &[ONE_LAP, scale]);
    let plain = changed("no-camera", &[ONE_LAP]);
    let scales = (0..100).map(|run| {
        let (drive, plain) = (scenario.drive(run), plain.drive(run));
        assert_eq!(drive.truth, plain.truth);
        let turns: Vec<f64> = (1..drive.truth.len()).map(|step| true_turn_rad(&drive, step) / 0.05).collect();
        let more = rates(&drive).into_iter().zip(rates(&plain)).map(|(scaled, plain)| scaled.1 - plain.1);
        more.zip(&turns).map(|(more, turn)| more * turn).sum::<f64>()
            / turns.iter().map(|turn| turn * turn).sum::<f64>()
    });
    assert_sigma(rms(scales), 0.05, 100, "scale");
}
