//! Corners are as accurate as their covariance says.

use nalgebra::SVector;
use posebridge_vision::{GreyImage, Tag36h11Detector, TagDetector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::drawing::{Camera, corners, draw, view};

/// Over many noisy pictures the squared errors of the corners, in units of their covariance, have a mean of eight and the errors a mean of
/// zero.
#[test]
fn the_errors_of_corners_are_those_of_their_covariance() {
    const PICTURES: u16 = 24;
    for (side_px, blur_px, noise) in [(16.0, 0.6, 3.0), (16.0, 0.75, 3.0), (36.0, 0.8, 6.0), (48.0, 1.2, 3.0)] {
        let mut random = Pcg32::seed_from_u64(11);
        let camera = Camera { black: 20.0, white: 200.0, blur_px, noise };
        let (mut nees, mut mean) = (0.0, SVector::<f64, 8>::zeros());
        for index in 0..PICTURES {
            let size = (1.9 * side_px) as usize + 20;
            let mut near = || size as f64 / 2.0 + random.random_range(-1.0..1.0);
            let view = view(near(), near(), side_px, 0.27 * f64::from(index), 0.3);
            let picture = draw(size, size, &[(9 * index, view)], camera, &mut random);
            let image = GreyImage::new(&picture.pixels, size, size, size).unwrap();
            let tags = Tag36h11Detector::default().detect(image);
            assert_eq!(tags.len(), 1, "{side_px} px, picture {index}");
            let drawn = corners(&view);
            let errors = SVector::<f64, 8>::from_fn(|row, _| {
                let (found, drawn) = (tags[0].corners[row / 2], drawn[row / 2]);
                if row % 2 == 0 { found.x - drawn.x } else { found.y - drawn.y }
            });
            mean += errors / f64::from(PICTURES);
            nees +=
                (errors.transpose() * tags[0].covariance.cholesky().unwrap().solve(&errors))[0] / f64::from(PICTURES);
        }
        println!("{side_px} px: NEES {nees:.2}, mean error {:.4} px", mean.norm());
        // 99 of 100 means of 24 times 8 degrees of freedom.
        assert!((5.9..10.1).contains(&nees), "{side_px} px: {nees}");
        assert!(mean.amax() < 0.02, "{side_px} px: {mean}");
    }
}
