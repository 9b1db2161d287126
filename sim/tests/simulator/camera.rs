//! What the camera sends has the statistics that the scenario asks for.

use crate::support::run;
use posebridge_sim::scenario::{Blackout, CameraOrder, CameraSettings};
use posebridge_sim::{CameraFix, Scenario, Simulation};

/// What is seen in ten minutes, at 10 Hz in 6000 images, of a robot that stands at the origin; without an error of the calibration.
fn camera_fixes(change: impl FnOnce(&mut CameraSettings)) -> Vec<CameraFix> {
    let mut scenario = Scenario::default().with_seed(21);
    scenario.drive.rest_s = 1_200.0;
    scenario.camera.patch_sigma_m = 0.0;
    change(&mut scenario.camera);
    let mut simulation = Simulation::new(scenario);
    run(&mut simulation, 600_000);
    simulation.camera_fixes().to_vec()
}

#[test]
fn position_heading_and_latency_have_their_spread() {
    let fixes = camera_fixes(|_| ());
    let count = fixes.len() as f64;
    // A sigma from 5900 draws is good to 1 %.
    let sigma = |error: fn(&CameraFix) -> f64| (fixes.iter().map(|fix| error(fix).powi(2)).sum::<f64>() / count).sqrt();
    for (name, found, expected) in [
        ("x", sigma(|fix| fix.position.x.0 - fix.true_tag.x.0), 0.005),
        ("y", sigma(|fix| fix.position.y.0 - fix.true_tag.y.0), 0.005),
        ("heading", sigma(|fix| (fix.heading.unwrap() - fix.true_tag.heading).0.to_degrees()), 1.0),
    ] {
        assert!((found / expected - 1.0).abs() < 0.04, "{name}: {found}");
    }
    let latencies_ms = fixes.iter().map(|fix| (fix.sent - fix.exposed).as_millis_f64());
    assert!(latencies_ms.clone().all(|latency| (50.0..=110.0).contains(&latency)));
    assert!(latencies_ms.clone().any(|latency| latency < 51.0) && latencies_ms.clone().any(|latency| latency > 109.0));
    let mean_ms = latencies_ms.sum::<f64>() / count;
    assert!((mean_ms - 80.0).abs() < 1.5, "{mean_ms} ms");
}

#[test]
fn an_error_of_the_calibration_shifts_all_fixes_from_one_place_alike_and_changes_nothing_else() {
    let (exact, wrong) = (camera_fixes(|_| ()), camera_fixes(|camera| camera.patch_sigma_m = 0.01));
    let shift_m = wrong[0].position.distance(exact[0].position).0;
    assert!((1e-4..0.06).contains(&shift_m), "{shift_m}");
    for (exact, mut wrong) in exact.into_iter().zip(wrong) {
        assert!((wrong.position.distance(exact.position).0 - shift_m).abs() < 1e-9);
        wrong.position = exact.position;
        assert_eq!(wrong, exact);
    }
}

#[test]
fn dropouts_and_outliers_come_at_their_rates_and_leave_the_other_fixes_as_they_were() {
    let with_outliers = |outlier| camera_fixes(|camera| (camera.dropout, camera.outlier) = (0.1, outlier));
    let fixes = with_outliers(0.05);
    let count = fixes.len() as f64;
    let dropped = 1.0 - count / 6_000.0;
    let outliers = fixes.iter().filter(|fix| fix.is_outlier).count() as f64 / count;
    // Binomial: sigma 0.4 % and 0.3 %.
    assert!((dropped - 0.1).abs() < 0.015, "{dropped}");
    assert!((outliers - 0.05).abs() < 0.012, "{outliers}");
    let errors_m = fixes.iter().map(|fix| (fix.is_outlier, fix.position.distance(fix.true_tag.origin()).0));
    let worst_m =
        |expected| errors_m.clone().filter(|(is_outlier, _)| *is_outlier == expected).fold(0.0, |w, (_, e)| e.max(w));
    assert!(worst_m(true) > 0.5 && worst_m(false) < 0.03);
    for (without, with) in with_outliers(0.0).iter().zip(&fixes).filter(|(_, with)| !with.is_outlier) {
        assert_eq!(without, with);
    }
}

#[test]
fn fixes_queue_up_or_overtake_as_configured() {
    let overtaken = |order| {
        let fixes = camera_fixes(|camera| (camera.order, camera.latency_ms, camera.jitter_ms) = (order, 150.0, 140.0));
        assert!(fixes.is_sorted_by_key(|fix| fix.sent));
        fixes.windows(2).filter(|pair| pair[0].exposed > pair[1].exposed).count()
    };
    assert_eq!(overtaken(CameraOrder::Fifo), 0);
    assert!(overtaken(CameraOrder::Free) > 100);
}

#[test]
fn blackouts_the_camera_s_own_clock_and_a_tag_off_the_axle_are_as_configured() {
    let fixes = camera_fixes(|camera| {
        camera.blackouts = vec![Blackout { from_s: 60.0, to_s: 240.0 }];
        camera.clock_start_micros = 7_000_000;
        camera.clock_skew_ppm = 500.0;
        camera.tag_x_m = 0.1;
        camera.position_sigma_m = 0.0;
    });
    for fix in &fixes {
        let exposed_s = fix.exposed.as_secs_f64();
        assert!(!(60.0..240.0).contains(&exposed_s));
        assert!((fix.time.as_secs_f64() - (7.0 + exposed_s * 1.000_5)).abs() < 2e-6);
        assert!((fix.position.x.0 - 0.1).abs() < 1e-12);
    }
    assert!((4_000..4_200).contains(&fixes.len()), "{}", fixes.len());
}
