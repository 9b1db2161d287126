//! Every figure of the table, over every shape of run: whole documents, finite numbers, nothing hidden.

use posebridge_report::{ComparedTrack, FIGURES, FixMark, PoseTrack, RunLayers, TimedPose};
use posebridge_telemetry::{Arena, Estimate, FusionOutcome, Heading, Meters, Point2, Pose, TimeDelta, Timestamp};
use proptest::prelude::*;

use crate::sample_run;

const TITLE: &str = "a < b & \"c\"";

#[test]
fn every_figure_draws_a_whole_run_the_same_way_twice() {
    let scene = sample_run::two_laps(7);
    for figure in FIGURES {
        let svg = (figure.render)(&scene.layers(TITLE));
        check_document(&svg).unwrap();
        assert_eq!(svg, (figure.render)(&scene.layers(TITLE)), "{}", figure.name);
        assert!(svg.contains("a &lt; b &amp; &quot;c&quot;"), "{}", figure.name);
        assert!(svg.contains("times better") && svg.contains("ANEES"), "{}", figure.name);
        assert!(!svg.contains("left out"), "{}", figure.name);
    }
}

#[test]
fn every_figure_does_with_any_layer_missing() {
    let scene = sample_run::two_laps(7);
    let whole = scene.layers(TITLE);
    let views = [
        RunLayers::default(),
        RunLayers { truth: None, ..whole },
        RunLayers { odometry: None, ..whole },
        RunLayers { estimates: &[], ..whole },
        RunLayers { fixes: &[], ideal: &[], ..whole },
        RunLayers { truth: None, odometry: None, estimates: &[], ..whole },
    ];
    for figure in FIGURES {
        for layers in &views {
            check_document(&(figure.render)(layers)).unwrap();
        }
    }
    let without_truth = render("track", &views[1]);
    assert!(without_truth.contains("no truth known"));
    assert!(!without_truth.contains("true path"));
    assert!(render("error", &views[0]).contains("nothing to compare"));
}

#[test]
fn a_smoothed_path_is_a_layer_of_its_own() {
    let scene = sample_run::two_laps(7);
    let without = scene.layers(TITLE);
    let with = RunLayers { smoothed: Some(&scene.odometry), ..without };
    for (figure, label) in [("track", "smoothed path"), ("error", "smoothed path's error")] {
        let (plain, smoothed) = (render(figure, &without), render(figure, &with));
        check_document(&smoothed).unwrap();
        assert!(!plain.contains(label), "{figure}");
        assert!(smoothed.contains(label), "{figure}");
        let lines = |svg: &str| svg.matches("<polyline").count();
        assert!(lines(&smoothed) > lines(&plain), "{figure}");
    }
}

#[test]
fn compared_filters_have_a_line_and_a_name_each_in_the_place_of_the_detail() {
    let scene = sample_run::two_laps(7);
    let without = scene.layers(TITLE);
    let compared = ["ekf5", "odometry"].map(|filter| ComparedTrack { filter, track: scene.odometry.clone() });
    let drawn = render("track", &RunLayers { compared: &compared, ..without });
    check_document(&drawn).unwrap();
    for name in ["filter ekf5", "filter odometry"] {
        assert!(drawn.contains(name), "{name}");
    }
    let detail = "least sure";
    assert!(render("track", &without).contains(detail) && !drawn.contains(detail));
}

#[test]
fn values_that_are_not_finite_are_counted_and_never_drawn() {
    let scene = sample_run::two_laps(7);
    let mut estimates = scene.estimates.clone();
    estimates[0].pose.x = Meters(f64::NAN);
    for row in &mut estimates[600].covariance {
        row.fill(f64::NAN);
    }
    let ideal = [Point2::new(Meters(f64::INFINITY), Meters(0.0))];
    let layers = RunLayers { estimates: &estimates, ideal: &ideal, ..scene.layers(TITLE) };
    for figure in FIGURES {
        let svg = (figure.render)(&layers);
        check_document(&svg).unwrap();
        assert!(svg.contains("left out: "), "{}", figure.name);
    }
}

#[test]
fn huge_values_do_not_hide_the_rest() {
    let scene = sample_run::two_laps(7);
    let mut samples = scene.odometry.samples().to_vec();
    samples[100].pose.x = Meters(1e300);
    samples[101].pose.y = Meters(-f64::MAX);
    let odometry = track_of(&samples);
    let layers = RunLayers { odometry: Some(&odometry), ..scene.layers(TITLE) };
    let svg = render("track", &layers);
    check_document(&svg).unwrap();
    assert!(svg.contains("left out: "));
    // The x axis of the map still spans the arena.
    assert!(svg.contains(">2.0</text>"), "{svg}");
}

#[test]
fn used_and_refused_fixes_differ_in_mark_and_a_refused_one_does_not_stretch_the_map() {
    let scene = sample_run::two_laps(7);
    let fix =
        |x_m, verdict| FixMark { time: Timestamp::ZERO, position: Point2::new(Meters(x_m), Meters(0.0)), verdict };
    let near = [fix(1.0, FusionOutcome::Accepted)];
    let both = [near[0], fix(500.0, FusionOutcome::Gated)];
    let draw = |fixes| render("track", &RunLayers { fixes, ..scene.layers(TITLE) });
    assert!(draw(&both).contains("fix, used (1)") && draw(&both).contains("fix, refused (1)"));
    let ticks = |svg: &str| svg.matches("#E6E6E6").count();
    assert_eq!(ticks(&draw(&near)), ticks(&draw(&both)));
    assert!(draw(&both).contains(">2.0</text>"));
}

#[test]
fn an_hour_at_100_hz_stays_a_small_picture() {
    let samples: Vec<TimedPose> = (0..360_000_i64)
        .map(|step| {
            let angle_rad = step as f64 * 1e-3;
            timed(step * 10, angle_rad.cos(), angle_rad.sin())
        })
        .collect();
    let odometry: Vec<TimedPose> =
        samples.iter().map(|sample| timed(sample.time.as_micros() / 1_000, sample.pose.x.0, 0.0)).collect();
    let (truth, odometry) = (track_of(&samples), track_of(&odometry));
    let layers = RunLayers { truth: Some(&truth), odometry: Some(&odometry), ..RunLayers::default() };
    let svg = render("error", &layers);
    assert!(svg.len() < 100_000, "{} bytes", svg.len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_numbers_make_a_whole_document(
        poses in prop::collection::vec((any::<i64>(), any::<f64>(), any::<f64>()), 0..12),
        variances in prop::array::uniform3(any::<f64>()),
    ) {
        let samples: Vec<TimedPose> = poses.iter().map(|&(millis, x, y)| timed(millis, x, y)).collect();
        let track = track_of(&samples);
        let template = sample_run::two_laps(1).estimates[0];
        let estimates: Vec<Estimate> = samples
            .iter()
            .map(|sample| {
                let mut covariance = template.covariance;
                covariance[0][0] = variances[0];
                covariance[0][1] = variances[1];
                covariance[1][1] = variances[2];
                Estimate { stamp: sample.time, pose: sample.pose, covariance, ..template }
            })
            .collect();
        let layers = RunLayers {
            truth: Some(&track),
            odometry: Some(&track),
            estimates: &estimates,
            ..RunLayers::default()
        };
        for figure in FIGURES {
            let checked = check_document(&(figure.render)(&layers));
            prop_assert!(checked.is_ok(), "{}: {checked:?}", figure.name);
        }
    }
}

fn render(name: &str, layers: &RunLayers<'_>) -> String {
    let figure = FIGURES.iter().find(|figure| figure.name == name);
    figure.map_or_else(String::new, |figure| (figure.render)(layers))
}

fn timed(millis: i64, x_m: f64, y_m: f64) -> TimedPose {
    TimedPose {
        time: Timestamp::from_millis(millis),
        pose: Pose::<Arena>::new(Meters(x_m), Meters(y_m), Heading::from_rad(0.1)),
    }
}

fn track_of(samples: &[TimedPose]) -> PoseTrack {
    PoseTrack::new(samples.iter().copied(), TimeDelta::from_millis(200))
}

/// A document whose tags nest, whose coordinates are finite numbers, and which is closed at its end.
fn check_document(svg: &str) -> Result<(), String> {
    for forbidden in ["NaN", "inf,", "\"inf", "inf\"", ",inf", "-inf"] {
        if svg.contains(forbidden) {
            return Err(format!("contains {forbidden}"));
        }
    }
    let mut open: Vec<&str> = Vec::new();
    let tags: Vec<&str> = svg.split('<').skip(1).collect();
    for (index, tag_text) in tags.iter().enumerate() {
        let (tag, _text) = tag_text.split_once('>').ok_or("a tag is not closed")?;
        if tag.matches('"').count() % 2 == 1 {
            return Err(format!("odd quotes in {tag}"));
        }
        let name = tag.split([' ', '/']).find(|part| !part.is_empty());
        if tag.starts_with('/') {
            if open.pop() != name {
                return Err(format!("{tag} closes another tag"));
            }
        } else if !tag.ends_with('/') {
            open.extend(name);
        }
        if open.is_empty() && index + 1 < tags.len() {
            return Err(format!("{tag} ends the document early"));
        }
        check_points(tag)?;
    }
    if open.is_empty() && !tags.is_empty() { Ok(()) } else { Err(format!("open: {open:?}")) }
}

fn check_points(tag: &str) -> Result<(), String> {
    let Some((_, points)) = tag.split_once("points=\"") else {
        return Ok(());
    };
    let (points, _) = points.split_once('"').ok_or("points are not closed")?;
    for number in points.split([' ', ',']) {
        let value: f64 = number.parse().map_err(|error| format!("{number}: {error}"))?;
        if !value.is_finite() {
            return Err(format!("{number} in {tag}"));
        }
    }
    Ok(())
}
