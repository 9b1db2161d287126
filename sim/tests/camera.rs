//! What the camera sends has the statistics that the scenario asks for.

use posebridge_sim::scenario::{Blackout, CameraOrder, CameraSettings};
use posebridge_sim::{CameraFix, Scenario, Simulation};

/// World time of the statistical runs; 10 Hz make 6000 images.
const RUN_S: f64 = 600.0;

#[test]
fn position_and_heading_have_their_sigmas() {
    let fixes = camera_fixes(|_| ());
    let count = fixes.len() as f64;
    let sigma =
        |error: &dyn Fn(&CameraFix) -> f64| (fixes.iter().map(|f| error(f).powi(2)).sum::<f64>() / count).sqrt();
    let x_m = sigma(&|f| f.position.x.0 - f.true_tag.x.0);
    let y_m = sigma(&|f| f.position.y.0 - f.true_tag.y.0);
    let heading_deg = sigma(&|f| (f.heading.unwrap() - f.true_tag.heading).0.to_degrees());
    // A sigma from 5900 draws is good to 1 %.
    assert!((x_m - 0.005).abs() < 0.0002, "{x_m}");
    assert!((y_m - 0.005).abs() < 0.0002, "{y_m}");
    assert!((heading_deg - 1.0).abs() < 0.04, "{heading_deg}");
}

#[test]
fn latency_lies_within_its_jitter_around_its_mean() {
    let fixes = camera_fixes(|_| ());
    let latencies: Vec<f64> = fixes.iter().map(|f| (f.sent - f.exposed).as_millis_f64()).collect();
    let mean = latencies.iter().sum::<f64>() / latencies.len() as f64;
    assert!((mean - 80.0).abs() < 1.5, "{mean} ms");
    assert!(latencies.iter().all(|l| (50.0..=110.0).contains(l)));
}

#[test]
fn dropouts_and_outliers_come_at_their_rates() {
    let fixes = camera_fixes(|camera| {
        camera.dropout = 0.1;
        camera.outlier = 0.05;
    });
    let images = RUN_S * 10.0;
    let dropped = 1.0 - fixes.len() as f64 / images;
    let outliers = fixes.iter().filter(|f| f.is_outlier).count() as f64 / fixes.len() as f64;
    // Binomial: sigma 0.4 % and 0.3 %.
    assert!((dropped - 0.1).abs() < 0.015, "{dropped}");
    assert!((outliers - 0.05).abs() < 0.012, "{outliers}");
    let worst = |wanted| {
        fixes
            .iter()
            .filter(|f| f.is_outlier == wanted)
            .map(|f| f.position.distance(f.true_tag.origin()).0)
            .fold(0.0, f64::max)
    };
    assert!(worst(true) > 0.5 && worst(false) < 0.03);
}

#[test]
fn more_outliers_leave_the_noise_of_the_other_fixes_as_it_was() {
    let without = camera_fixes(|camera| camera.outlier = 0.0);
    let with = camera_fixes(|camera| camera.outlier = 0.2);
    for (a, b) in without.iter().zip(&with).filter(|(_, b)| !b.is_outlier) {
        assert_eq!(a, b);
    }
}

#[test]
fn fixes_queue_up_or_overtake_as_configured() {
    let overtaken = |order| {
        let fixes = camera_fixes(|camera| {
            camera.order = order;
            camera.latency_ms = 150.0;
            camera.jitter_ms = 140.0;
        });
        assert!(fixes.windows(2).all(|pair| pair[0].sent <= pair[1].sent));
        fixes.windows(2).filter(|pair| pair[0].exposed > pair[1].exposed).count()
    };
    assert_eq!(overtaken(CameraOrder::Fifo), 0);
    assert!(overtaken(CameraOrder::Free) > 100);
}

#[test]
fn nothing_is_seen_in_a_blackout() {
    let fixes = camera_fixes(|camera| {
        camera.blackouts = vec![Blackout { from_s: 60.0, to_s: 240.0 }];
    });
    assert!(!fixes.iter().any(|f| (60.0..240.0).contains(&f.exposed.as_secs_f64())));
    assert!(fixes.iter().any(|f| f.exposed.as_secs_f64() > 240.0));
}

#[test]
fn stamps_are_the_exposures_by_the_cameras_own_clock() {
    let fixes = camera_fixes(|camera| {
        camera.clock_start_micros = 7_000_000;
        camera.clock_skew_ppm = 500.0;
    });
    let last = fixes.last().unwrap();
    let expected_s = 7.0 + last.exposed.as_secs_f64() * 1.000_5;
    assert!((last.time.as_secs_f64() - expected_s).abs() < 2e-6);
}

#[test]
fn a_tag_off_the_axle_is_seen_where_it_is() {
    let fixes = camera_fixes(|camera| {
        camera.tag_x_m = 0.1;
        camera.position_sigma_m = 0.0;
    });
    assert!((fixes[0].position.x.0 - 0.1).abs() < 1e-12);
}

/// What is seen of a robot that stands at the origin.
fn camera_fixes(change: impl FnOnce(&mut CameraSettings)) -> Vec<CameraFix> {
    let mut scenario = Scenario::default().with_seed(21);
    scenario.drive.rest_s = 2.0 * RUN_S;
    change(&mut scenario.camera);
    let mut simulation = Simulation::new(scenario);
    while simulation.elapsed().as_secs_f64() < RUN_S {
        simulation.step();
        while simulation.poll().is_some() {}
    }
    simulation.camera_fixes().to_vec()
}
