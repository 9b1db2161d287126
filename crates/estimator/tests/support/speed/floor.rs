//! The floor: what is left when everything general is written out by hand.
//!
//! Fifteen numbers for P, one name each, scalar updates without a gate, and both headings fused to one beforehand, which is
//! the same as one after the other because their errors are independent. It knows nothing of the library.

use super::{FilterState, INITIAL_VARIANCE, INTERVAL_S, Input, OBSERVED_VARIANCES, PROCESS_VARIANCES};

/// The variance of the two headings' weighted mean.
const HEADING_VARIANCE: f64 = 1.0 / (1.0 / OBSERVED_VARIANCES[1] + 1.0 / OBSERVED_VARIANCES[2]);
/// The weights of encoders and gyro in it.
const HEADING_WEIGHTS: [f64; 2] = [HEADING_VARIANCE / OBSERVED_VARIANCES[1], HEADING_VARIANCE / OBSERVED_VARIANCES[2]];

/// States x, y, h(eading), v, w and the upper triangle of P.
#[derive(Clone, Copy, Default)]
struct Floor {
    x: f64,
    y: f64,
    h: f64,
    v: f64,
    w: f64,
    xx: f64,
    xy: f64,
    xh: f64,
    xv: f64,
    xw: f64,
    yy: f64,
    yh: f64,
    yv: f64,
    yw: f64,
    hh: f64,
    hv: f64,
    hw: f64,
    vv: f64,
    vw: f64,
    ww: f64,
}

/// One scalar update: `$column` names the observed state's column of P, `$diagonal` its own variance.
macro_rules! scalar_update {
    ($b:ident, $innovation:expr, $variance:expr, $diagonal:ident,
     [$cx:ident, $cy:ident, $ch:ident, $cv:ident, $cw:ident]) => {
        let innovation = $innovation;
        let (cx, cy, ch, cv, cw) = ($b.$cx, $b.$cy, $b.$ch, $b.$cv, $b.$cw);
        let inverse = 1.0 / ($b.$diagonal + $variance);
        let (kx, ky, kh, kv, kw) = (cx * inverse, cy * inverse, ch * inverse, cv * inverse, cw * inverse);
        $b.x += kx * innovation;
        $b.y += ky * innovation;
        $b.h += kh * innovation;
        $b.v += kv * innovation;
        $b.w += kw * innovation;
        $b.xx -= kx * cx;
        $b.xy -= kx * cy;
        $b.xh -= kx * ch;
        $b.xv -= kx * cv;
        $b.xw -= kx * cw;
        $b.yy -= ky * cy;
        $b.yh -= ky * ch;
        $b.yv -= ky * cv;
        $b.yw -= ky * cw;
        $b.hh -= kh * ch;
        $b.hv -= kh * cv;
        $b.hw -= kh * cw;
        $b.vv -= kv * cv;
        $b.vw -= kv * cw;
        $b.ww -= kw * cw;
    };
}

impl Floor {
    fn predict(&mut self, input: &Input) {
        const T: f64 = INTERVAL_S;
        const Q: [f64; 5] = PROCESS_VARIANCES;
        let b = *self;
        let (sin, cos) = (b.h + 0.5 * T * b.w).sin_cos();
        let (fxv, fyv) = (T * cos, T * sin);
        let (fxh, fyh) = (-b.v * fyv, b.v * fxv);
        let (fxw, fyw) = (0.5 * T * fxh, 0.5 * T * fyh);
        self.x += b.v * fxv;
        self.y += b.v * fyv;
        self.h += T * b.w;
        self.v += T * input.forward_m_per_s2;
        self.w += T * input.turn_rad_per_s2;

        let xx = b.xx + fxh * b.xh + fxv * b.xv + fxw * b.xw;
        let xy = b.xy + fxh * b.yh + fxv * b.yv + fxw * b.yw;
        let xh = b.xh + fxh * b.hh + fxv * b.hv + fxw * b.hw;
        let xv = b.xv + fxh * b.hv + fxv * b.vv + fxw * b.vw;
        let xw = b.xw + fxh * b.hw + fxv * b.vw + fxw * b.ww;
        let yy = b.yy + fyh * b.yh + fyv * b.yv + fyw * b.yw;
        let yh = b.yh + fyh * b.hh + fyv * b.hv + fyw * b.hw;
        let yv = b.yv + fyh * b.hv + fyv * b.vv + fyw * b.vw;
        let yw = b.yw + fyh * b.hw + fyv * b.vw + fyw * b.ww;
        let hw = b.hw + T * b.ww;
        self.xx = xx + fxh * xh + fxv * xv + fxw * xw + Q[0];
        self.xy = xy + fyh * xh + fyv * xv + fyw * xw;
        self.xh = xh + T * xw;
        self.xv = xv;
        self.xw = xw;
        self.yy = yy + fyh * yh + fyv * yv + fyw * yw + Q[1];
        self.yh = yh + T * yw;
        self.yv = yv;
        self.yw = yw;
        self.hh = b.hh + T * b.hw + T * hw + Q[2];
        self.hv = b.hv + T * b.vw;
        self.hw = hw;
        self.vv = b.vv + Q[3];
        self.ww = b.ww + Q[4];
    }

    fn update(&mut self, observed: &[f64; 4]) {
        const R: [f64; 4] = OBSERVED_VARIANCES;
        let [v, by_encoders, by_gyro, w] = *observed;
        let heading = HEADING_WEIGHTS[0] * by_encoders + HEADING_WEIGHTS[1] * by_gyro;
        let mut b = *self;
        scalar_update!(b, v - b.v, R[0], vv, [xv, yv, hv, vv, vw]);
        scalar_update!(b, heading - b.h, HEADING_VARIANCE, hh, [xh, yh, hh, hv, hw]);
        scalar_update!(b, w - b.w, R[3], ww, [xw, yw, hw, vw, ww]);
        *self = b;
    }

    fn belief(&self) -> FilterState {
        let b = self;
        FilterState {
            mean: [b.x, b.y, b.h, b.v, b.w],
            covariance: [
                [b.xx, b.xy, b.xh, b.xv, b.xw],
                [b.xy, b.yy, b.yh, b.yv, b.yw],
                [b.xh, b.yh, b.hh, b.hv, b.hw],
                [b.xv, b.yv, b.hv, b.vv, b.vw],
                [b.xw, b.yw, b.hw, b.vw, b.ww],
            ],
        }
    }
}

pub(super) fn run(inputs: &[Input]) -> FilterState {
    let mut floor = Floor {
        xx: INITIAL_VARIANCE,
        yy: INITIAL_VARIANCE,
        hh: INITIAL_VARIANCE,
        vv: INITIAL_VARIANCE,
        ww: INITIAL_VARIANCE,
        ..Floor::default()
    };
    for input in inputs {
        floor.predict(input);
        floor.update(&input.observed);
    }
    floor.belief()
}
