//! Finds the tags in a picture.

use nalgebra::{Point2, SMatrix};

use crate::decode::decode;
use crate::grey_image::{GreyImage, ImageWindow};
use crate::homography::{Homography, LensAxis};
use crate::outline::{Outline, for_each_outline};
use crate::quad::{MIN_POINTS, Quad, fit_quad};
use crate::refine::Refinement;
use crate::tag36h11::SIDE;
use crate::threshold::DarkPixels;

/// A tag in a picture.
#[derive(Clone, Copy, Debug)]
pub struct DetectedTag {
    pub id: u16,
    /// Wrong bits.
    pub hamming: u32,
    /// Mean distance of the bits from the level between black and white, grey levels.
    pub margin: f64,
    /// Corners of the black rim: the tag's upper left one, then clockwise. Pixels; the centre of the first pixel is (0, 0).
    pub corners: [Point2<f64>; 4],
    /// Of x and y of the four corners, px².
    pub covariance: SMatrix<f64, 8, 8>,
}

/// Finds tags of one family.
pub trait TagDetector {
    /// The tags in a picture, each id once, the clearest.
    fn detect(&mut self, image: GreyImage<'_>) -> Vec<DetectedTag> {
        let window = ImageWindow { left: 0, top: 0, width: image.width(), height: image.height() };
        self.detect_in_window(image, window)
    }

    /// Those in a part of the picture, with corners in the whole of it: a lens bends around the middle of the whole.
    fn detect_in_window(&mut self, image: GreyImage<'_>, window: ImageWindow) -> Vec<DetectedTag>;
}

/// Finds tags of the family tag36h11.
#[derive(Default)]
pub struct Tag36h11Detector {
    dark: DarkPixels,
    outline: Outline,
    quads: Vec<Quad>,
}

impl TagDetector for Tag36h11Detector {
    fn detect_in_window(&mut self, image: GreyImage<'_>, window: ImageWindow) -> Vec<DetectedTag> {
        let ImageWindow { left, top, width, height } = window;
        let axis = LensAxis::of_picture(image.width(), image.height(), left, top);
        let image = image.window(left, top, width, height);
        let Self { dark, outline, quads } = self;
        dark.find(image);
        quads.clear();
        for_each_outline(dark, outline, MIN_POINTS, |outline| quads.extend(fit_quad(outline)));
        let mut tags: Vec<DetectedTag> = Vec::new();
        for tag in quads.iter().filter_map(|quad| detect_in(image, axis, quad)) {
            match tags.iter_mut().find(|other| other.id == tag.id) {
                Some(other) if other.margin < tag.margin => *other = tag,
                Some(_) => {}
                None => tags.push(tag),
            }
        }
        for corner in tags.iter_mut().flat_map(|tag| &mut tag.corners) {
            corner.x += left as f64;
            corner.y += top as f64;
        }
        tags
    }
}

fn detect_in(image: GreyImage<'_>, axis: LensAxis, quad: &Quad) -> Option<DetectedTag> {
    let side = SIDE as f64;
    let rough = Homography::of_square(side, quad)?;
    let mut quad = *quad;
    let mut decoded = decode(image, &rough)?;
    if decoded.tag.is_none() {
        // The outline runs between whole pixels: that is too coarse for modules of little more than one.
        quad = Refinement::new(image, axis, None, &rough)?.run(&rough, decoded.black, decoded.white)?.corners;
        decoded = decode(image, &Homography::of_square(side, &quad)?)?;
    }
    let tag = decoded.tag?;
    // From here on with the tag's own first corner.
    let turned = std::array::from_fn(|corner| quad[(corner + tag.turns) % 4]);
    let modules = Homography::of_square(side, &turned)?;
    let refinement = Refinement::new(image, axis, Some(tag.id), &modules)?;
    let refined = refinement.run(&modules, decoded.black, decoded.white)?;
    Some(DetectedTag {
        id: tag.id,
        hamming: tag.hamming,
        margin: decoded.margin,
        corners: refined.corners,
        covariance: refined.covariance,
    })
}
