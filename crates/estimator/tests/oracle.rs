//! The update against a filter that somebody else wrote: `adskalman`, by Cholesky and in Joseph's form.

use adskalman::{CovarianceUpdateMethod, ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Matrix4x2, U2, U4, Vector2, Vector4};
use posebridge_estimator::update::{
    LinearizedMeasurement, ScalarMeasurement, UpdateOutcome, apply_measurement, use_scalar,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

const STEPS: usize = 400;
/// Rounding over all steps, at numbers of about one.
const AGREEMENT: f64 = 1e-9;

/// One step of a linear system: x' = F x + w, z = H x + v.
struct Linear {
    f: Matrix4<f64>,
    ft: Matrix4<f64>,
    q: Matrix4<f64>,
    h: Matrix2x4<f64>,
    ht: Matrix4x2<f64>,
    r: Matrix2<f64>,
}

impl TransitionModelLinearNoControl<f64, U4> for Linear {
    fn F(&self) -> &Matrix4<f64> {
        &self.f
    }
    fn FT(&self) -> &Matrix4<f64> {
        &self.ft
    }
    fn Q(&self) -> &Matrix4<f64> {
        &self.q
    }
}

impl ObservationModel<f64, U4, U2> for Linear {
    fn H(&self) -> &Matrix2x4<f64> {
        &self.h
    }
    fn HT(&self) -> &Matrix4x2<f64> {
        &self.ht
    }
    fn R(&self) -> &Matrix2<f64> {
        &self.r
    }
}

/// Draws systems and observations.
struct RandomSystems(Pcg64);

impl RandomSystems {
    fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// A new system: F near a rotation with damping, so that nothing grows without bound; H, Q and R of any kind.
    fn system(&mut self) -> Linear {
        let f = Matrix4::from_fn(|i, j| f64::from(u8::from(i == j)) * 0.8 + 0.1 * self.normal());
        let h = Matrix2x4::from_fn(|_, _| self.normal());
        let q = Matrix4::from_fn(|_, _| 0.2 * self.normal());
        let r = Matrix2::from_fn(|_, _| 0.5 * self.normal());
        Linear {
            f,
            ft: f.transpose(),
            q: q * q.transpose() + Matrix4::identity() * 1e-3,
            h,
            ht: h.transpose(),
            r: r * r.transpose() + Matrix2::identity() * 1e-2,
        }
    }
}

/// The library's belief.
#[derive(Clone, Copy)]
struct LibraryFilter {
    mean: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl LibraryFilter {
    fn predict(&mut self, system: &Linear) {
        self.mean = system.f * self.mean;
        self.covariance = system.f * self.covariance * system.ft + system.q;
        posebridge_estimator::numerics::covariance::symmetrise(&mut self.covariance);
    }

    fn distance(&self, other: &StateAndCovariance<f64, U4>) -> f64 {
        let mean = (self.mean - other.state()).amax();
        mean.max((self.covariance - other.covariance()).amax())
    }
}

#[test]
fn scalar_updates_agree_with_a_foreign_filter_over_hundreds_of_random_steps() {
    let mut draw = RandomSystems(Pcg64::seed_from_u64(0x0a_c1e5));
    let start = LibraryFilter { mean: Vector4::new(1.0, -0.5, 0.2, 2.0), covariance: Matrix4::identity() * 0.7 };
    let (mut scalar, mut whitened) = (start, start);
    let mut foreign = StateAndCovariance::new(start.mean, start.covariance);
    for step in 0..STEPS {
        let system = draw.system();
        let z = Vector2::new(2.0 * draw.normal(), 2.0 * draw.normal());

        let prior = TransitionModelLinearNoControl::predict(&system, &foreign);
        let joseph = CovarianceUpdateMethod::JosephForm;
        foreign = system.update(&prior, &z, joseph).unwrap();

        // By hand: L^-1 z and L^-1 H with R = L L', then each component alone.
        scalar.predict(&system);
        let lower = system.r.cholesky().unwrap().l();
        let white_z = lower.solve_lower_triangular(&z).unwrap();
        let white_h = lower.solve_lower_triangular(&system.h).unwrap();
        for i in 0..2 {
            let row = white_h.row(i);
            let one = ScalarMeasurement {
                innovation: white_z[i] - (row * scalar.mean)[0],
                rows: [0, 1, 2, 3],
                jacobian: std::array::from_fn(|j| row[j]),
                variance: 1.0,
            };
            let outcome = use_scalar(&mut scalar.mean, &mut scalar.covariance, &one, f64::INFINITY);
            assert_eq!(outcome.outcome, UpdateOutcome::Used, "step {step}");
        }

        // By the library's own whitening.
        whitened.predict(&system);
        let measurement =
            LinearizedMeasurement { innovation: z - system.h * whitened.mean, jacobian: system.h, noise: system.r };
        assert!(apply_measurement(&mut whitened.mean, &mut whitened.covariance, &measurement));

        for (name, own) in [("use_scalar", &scalar), ("apply", &whitened)] {
            let distance = own.distance(&foreign);
            assert!(distance < AGREEMENT, "{name}, step {step}: {distance:e}");
        }
    }
}
