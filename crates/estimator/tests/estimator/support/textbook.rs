//! The Kalman update of all components at once, by a matrix inverse, as any textbook has it.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Updates mean and covariance by z = H x + v with the covariance R of v.
pub(crate) fn update<const N: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    h: &SMatrix<f64, M, N>,
    r: &SMatrix<f64, M, M>,
    z: &SVector<f64, M>,
) {
    let s = h * *covariance * h.transpose() + r;
    let gain = *covariance * h.transpose() * s.try_inverse().expect("positive definite");
    *mean += gain * (z - h * *mean);
    *covariance = (SMatrix::identity() - gain * h) * *covariance;
}

#[test]
fn an_update_equals_one_by_hand() {
    // P = [2 1; 1 1], H = [1 1; 0 1], R = I:
    // S = H P H' + R = [6 2; 2 2], its inverse 1/8 [2 -2; -2 6];
    // K = P H' S^-1 = [3 1; 2 1] 1/8 [2 -2; -2 6] = 1/8 [4 0; 2 2];
    // x + K (z - H x) = [1; 2] + K ([7; 6] - [3; 2]) = [1; 2] + [2; 2] = [3; 4];
    // (I - K H) P = 1/8 [4 -4; -2 4] [2 1; 1 1] = 1/8 [4 0; 0 2].
    let mut mean = Vector2::new(1.0, 2.0);
    let mut covariance = Matrix2::new(2.0, 1.0, 1.0, 1.0);
    let h = Matrix2::new(1.0, 1.0, 0.0, 1.0);
    update(&mut mean, &mut covariance, &h, &Matrix2::identity(), &Vector2::new(7.0, 6.0));
    assert!((mean - Vector2::new(3.0, 4.0)).amax() < 1e-12, "{mean}");
    assert!((covariance - Matrix2::new(0.5, 0.0, 0.0, 0.25)).amax() < 1e-12, "{covariance}");
}
