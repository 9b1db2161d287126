//! Saved states of filters: how they become bytes, and what is demanded of bytes from another machine.
//!
//! The format is [postcard](https://postcard.jamesmunns.com/wire-format): floats by their bits, integers with as many bytes as they need.
//! It names no fields, so a state is read by the program version that wrote it, and for the same configuration; whoever keeps the bytes
//! writes both in front of them. What is read is checked before it is used: numbers are finite, covariances symmetric with a diagonal that
//! goes with the rest, instants in order, and no list longer than the filter would have made it.

use std::collections::VecDeque;

use nalgebra::SMatrix;
use posebridge_telemetry::Transform2;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer, Serialize};

/// Longest list in a saved state: three seconds of four sensors that are read a thousand times a second, several times over.
pub const MAX_ENTRIES: usize = 65_536;
/// Largest number: the square of the largest that an observation may have.
const MAX_MAGNITUDE: f64 = 1e18;
/// Asymmetry of a covariance, and what an element may exceed the variances by, as shares of the largest variance.
const COVARIANCE_TOLERANCE: f64 = 1e-6;
/// The same where all variances are tiny, SI units squared.
const COVARIANCE_FLOOR: f64 = 1e-12;

/// Why a saved state was not restored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RestoreError {
    #[error("its bytes are damaged, or it has numbers that cannot be")]
    Damaged,
    #[error("{0}")]
    Implausible(&'static str),
    #[error("this filter cannot be continued elsewhere")]
    Unsupported,
}

pub fn to_bytes<T: Serialize>(state: &T) -> Vec<u8> {
    // It fails for lists of unknown length alone, and states have none.
    postcard::to_allocvec(state).unwrap_or_default()
}

/// Fails also where bytes are left over.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, RestoreError> {
    match postcard::take_from_bytes(bytes) {
        Ok((state, [])) => Ok(state),
        Ok(_) | Err(_) => Err(RestoreError::Damaged),
    }
}

/// The state at the beginning of some bytes, and what follows it.
pub fn split_first<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<(T, &'a [u8]), RestoreError> {
    // postcard says no more than that it is damage.
    postcard::take_from_bytes(bytes).or(Err(RestoreError::Damaged))
}

/// Numbers of a state.
pub trait Numbers {
    /// Whether all are finite, and not so large that their products are not.
    fn are_finite(&self) -> bool;
}

impl Numbers for f64 {
    fn are_finite(&self) -> bool {
        self.abs() <= MAX_MAGNITUDE
    }
}

impl<T: Numbers, const N: usize> Numbers for [T; N] {
    fn are_finite(&self) -> bool {
        self.iter().all(T::are_finite)
    }
}

impl<T: Numbers> Numbers for Option<T> {
    fn are_finite(&self) -> bool {
        self.as_ref().is_none_or(T::are_finite)
    }
}

impl<const R: usize, const C: usize> Numbers for SMatrix<f64, R, C> {
    fn are_finite(&self) -> bool {
        self.iter().all(f64::are_finite)
    }
}

impl<Target, Source> Numbers for Transform2<Target, Source> {
    fn are_finite(&self) -> bool {
        [self.x.0, self.y.0, self.heading.rad()].are_finite()
    }
}

/// For `#[serde(deserialize_with)]`: refuses numbers that are not finite.
pub fn finite<'de, D: Deserializer<'de>, T: Deserialize<'de> + Numbers>(from: D) -> Result<T, D::Error> {
    let numbers = T::deserialize(from)?;
    if numbers.are_finite() { Ok(numbers) } else { Err(D::Error::custom("a number that is not finite")) }
}

/// For `#[serde(deserialize_with)]`: refuses a negative number, too.
pub fn not_negative<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let number: f64 = finite(from)?;
    if number >= 0.0 { Ok(number) } else { Err(D::Error::custom("a negative number")) }
}

/// For `#[serde(deserialize_with)]`: a number that may be infinite.
pub fn not_nan<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let number = f64::deserialize(from)?;
    if number.is_nan() { Err(D::Error::custom("not a number")) } else { Ok(number) }
}

/// For `#[serde(deserialize_with)]`: refuses a matrix that is no covariance.
pub fn covariance<'de, D: Deserializer<'de>, const N: usize>(from: D) -> Result<SMatrix<f64, N, N>, D::Error> {
    let matrix = SMatrix::deserialize(from)?;
    if is_covariance(&matrix) { Ok(matrix) } else { Err(D::Error::custom("a matrix that is no covariance")) }
}

/// Whether a matrix is finite and symmetric, without a negative variance, and no element exceeds the variances of its row and column.
pub fn is_covariance<const N: usize>(matrix: &SMatrix<f64, N, N>) -> bool {
    let largest = matrix.diagonal().amax();
    let tolerance = COVARIANCE_TOLERANCE * largest + COVARIANCE_FLOOR;
    let is_sound = |i: usize, j: usize| {
        let (here, there) = (matrix[(i, j)], matrix[(j, i)]);
        let limit = (matrix[(i, i)].max(0.0) * matrix[(j, j)].max(0.0)).sqrt();
        (here - there).abs() <= tolerance && here.abs() <= limit + tolerance
    };
    matrix.are_finite()
        && matrix.diagonal().iter().all(|variance| *variance >= -tolerance)
        && (0..N).all(|i| (0..i).all(|j| is_sound(i, j)))
}

/// Whether a list rises by a key, where `may_follow` says whether a key may follow another.
pub fn is_ordered<T, K: Copy>(list: &VecDeque<T>, key: impl Fn(&T) -> K, may_follow: impl Fn(K, K) -> bool) -> bool {
    let pairs = list.iter().zip(list.iter().skip(1));
    list.len() <= MAX_ENTRIES && pairs.into_iter().all(|(one, next)| may_follow(key(one), key(next)))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::*;

    #[test]
    fn floats_keep_their_bits() {
        let numbers = [0.1, -0.0, f64::MIN_POSITIVE, f64::INFINITY, f64::from_bits(0x7ff8_0000_dead_beef)];
        let read: [f64; 5] = from_bytes(&to_bytes(&numbers)).expect("it was written so");
        assert_eq!(read.map(f64::to_bits), numbers.map(f64::to_bits));
    }

    #[test]
    fn bytes_that_are_left_over_or_missing_are_damage() {
        let bytes = to_bytes(&[1.0, 2.0]);
        assert_eq!(from_bytes::<[f64; 1]>(&bytes), Err(RestoreError::Damaged));
        assert_eq!(from_bytes::<[f64; 2]>(&bytes[..15]), Err(RestoreError::Damaged));
    }

    #[test]
    fn a_length_that_the_bytes_do_not_have_allocates_little() {
        let bytes = to_bytes(&u64::MAX);
        let memory = allocation_counter::measure(|| assert!(from_bytes::<Vec<[f64; 8]>>(&bytes).is_err()));
        assert!(memory.bytes_max < 2 << 20, "{memory:?}");
    }

    #[test]
    fn a_covariance_is_symmetric_and_no_element_exceeds_its_variances() {
        assert!(is_covariance(&Matrix2::new(4.0, 2.9, 2.9, 2.25)));
        assert!(is_covariance(&Matrix2::new(1.0, 0.0, 0.0, -1e-12)), "rounding");
        for (xx, xy, yx, yy) in
            [(4.0, 3.1, 3.1, 2.25), (4.0, 1.0, 1.1, 2.25), (-0.1, 0.0, 0.0, 1.0), (f64::NAN, 0.0, 0.0, 1.0)]
        {
            assert!(!is_covariance(&Matrix2::new(xx, xy, yx, yy)), "{xx} {xy} {yx} {yy}");
        }
    }
}
