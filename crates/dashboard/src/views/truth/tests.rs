use insta::assert_json_snapshot;
use posebridge_telemetry::{Address, Event, Heading, LinkId, Meters, Pose, RobotId, Timestamp};

use super::super::tests::{at, estimate, estimated_event, history, robot, truth, updates, view};
use super::*;

#[test]
fn an_estimate_is_held_against_the_truth_of_its_own_instant() {
    // The robot was at 1.5 m when the estimate holds, between two samples; it is 3 cm beside it.
    let samples = [truth(None, 4_960, 1.46), truth(None, 5_040, 1.54)];
    let estimated = estimated_event(&estimate());
    let mut late = view("truth");
    late.observe(at(960), ViewInput::Truth(&samples[0]));
    late.observe(at(1_000), ViewInput::Event(&estimated));
    let before = updates(&mut *late, FrameContent::Delta).errors.unwrap();
    assert_eq!(before.estimate_m.get(), None, "the sample behind it has not come");
    late.observe(at(1_040), ViewInput::Truth(&samples[1]));
    let frame = updates(&mut *late, FrameContent::Delta);
    assert_json_snapshot!("truth", (&frame.errors, frame.truth, frame.robots));
    let mut early = view("truth");
    for sample in &samples {
        early.observe(at(1_040), ViewInput::Truth(sample));
    }
    early.observe(at(1_050), ViewInput::Event(&estimated));
    assert_eq!(history(&*early).errors, frame.errors);
    let mut truncated = view("truth");
    for sample in [truth(None, 3_000, 1.5), truth(None, 5_040, 1.5)] {
        truncated.observe(at(1_040), ViewInput::Truth(&sample));
    }
    truncated.observe(at(1_050), ViewInput::Event(&estimated));
    let unknown = history(&*truncated).errors.unwrap().estimate_m;
    assert_eq!(unknown.get(), None, "nobody knows what was in two seconds");
    assert!(history(&*truncated).robots[0].scores.is_empty());
}

#[test]
fn every_estimate_of_a_message_has_its_score_and_late_truth_changes_none() {
    let mut view = view("truth");
    // 50 estimates a second, 20 samples a second, both as long on their way.
    for step in 0..200 {
        let millis = 10 * step;
        if step % 5 == 0 {
            let sample = truth(None, 4_000 + millis, 0.001 * millis as f64);
            view.observe(at(millis), ViewInput::Truth(&sample));
        }
        if step % 2 == 0 {
            let mut estimate = estimate();
            estimate.stamp = Timestamp::from_millis(4_000 + millis);
            estimate.pose = Pose::new(Meters(0.001 * millis as f64), Meters(-0.28 + 0.002), Heading::from_rad(0.6));
            // They come 0.3 s later than they hold: comparing by arrival is 0.3 m off.
            view.observe(at(millis + 300), ViewInput::Event(&estimated_event(&estimate)));
        }
    }
    let frame = updates(&mut *view, FrameContent::Delta);
    let scores = &frame.robots[0].scores;
    assert!(scores.len() >= 95, "{}", scores.len());
    for score in scores {
        let off_m = score.estimate_m.get().unwrap();
        assert!((off_m - 0.002).abs() < 1e-6, "{score:?}");
        let odometry_m = score.odometry_m.get().unwrap();
        assert!((odometry_m - 0.5).abs() < 1e-6, "{score:?}");
    }
    assert_eq!(scores[0].t_s, 0.3);
    assert_eq!(history(&*view).robots[0].scores.len(), 33, "50 ms apart or more");
}

#[test]
fn each_robot_is_held_against_its_own_truth() {
    let robots = [1, 2].map(|system| RobotId { link: LinkId(0), address: Address::new(system, 1) });
    // Both say 1.5 m; the first is right, the second 1 m off. Their clocks are not the same.
    let mut view = view("truth");
    for (robot, x_m) in robots.into_iter().zip([1.5, 2.5]) {
        for stamp in [4_960, 5_040] {
            view.observe(at(1_040), ViewInput::Truth(&truth(Some(robot), stamp, x_m)));
        }
        view.observe(at(1_040), ViewInput::Truth(&truth(Some(robot), 9_000, x_m)));
    }
    for robot in robots.into_iter().rev() {
        view.observe(at(1_050), ViewInput::Event(&Event::EstimateUpdated { robot, estimate: estimate() }));
    }
    let frame = updates(&mut *view, FrameContent::Delta);
    assert_eq!(frame.truth.len(), 6);
    assert_eq!(frame.truth[5].robot.as_deref(), Some("0/2/1"));
    for (part, off_m) in frame.robots.iter().zip([0.03, 1.0]) {
        let errors = part.errors.as_ref().unwrap().estimate_m.get().unwrap();
        let score = part.scores[0].estimate_m.get().unwrap();
        assert!((errors - off_m).abs() < 1e-3 && (score - off_m).abs() < 1e-3, "{}: {errors} {score}", part.id);
    }
    assert_eq!(frame.robots.len(), 2);
    assert_eq!(frame.errors, frame.robots[0].errors);
    assert_eq!(history(&*view), frame);
}

#[test]
fn a_truth_without_a_robot_is_of_the_first_one_only() {
    let mut view = view("truth");
    for sample in [truth(None, 4_960, 1.46), truth(None, 5_040, 1.54)] {
        view.observe(at(1_040), ViewInput::Truth(&sample));
    }
    for system in [7, 1] {
        let robot = RobotId { address: Address::new(system, 1), ..robot() };
        view.observe(at(1_050), ViewInput::Event(&Event::EstimateUpdated { robot, estimate: estimate() }));
    }
    let scored: Vec<_> = history(&*view).robots.into_iter().map(|part| (part.id, part.scores.len())).collect();
    assert_eq!(scored, [("0/7/1".to_owned(), 1)]);
}

#[test]
fn an_estimate_that_nobody_renews_is_not_said_to_be_good() {
    let mut view = view("truth");
    for sample in [truth(None, 4_960, 1.46), truth(None, 5_040, 1.54)] {
        view.observe(at(1_040), ViewInput::Truth(&sample));
    }
    view.observe(at(1_050), ViewInput::Event(&estimated_event(&estimate())));
    let known = updates(&mut *view, FrameContent::Delta).errors.unwrap();
    assert!(known.estimate_m.get().is_some());
    // The cable is out; the simulator goes on sending.
    for step in 0..40 {
        let sample = truth(None, 5_090 + 50 * step, 1.5);
        view.observe(sample.now, ViewInput::Truth(&sample));
    }
    let frame = updates(&mut *view, FrameContent::Delta);
    let errors = frame.errors.unwrap();
    assert_eq!(errors.estimate_m.get(), None);
    assert!(errors.odometry_m.get().is_some());
    assert_eq!(history(&*view).errors.unwrap().estimate_m.get(), None);
    let gap = &frame.robots[0].scores;
    assert_eq!(gap[0].t_s, 2.09, "a second behind the last comparison");
    assert!(gap.iter().all(|one| one.estimate_m.get().is_none()));
    assert!(gap.iter().all(|one| one.odometry_m.get().is_some()));
}
