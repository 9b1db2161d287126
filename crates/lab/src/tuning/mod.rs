//! Tunes noise parameters on recordings by the likelihood of the innovations.
//!
//! # Model
//! ```text
//! x_j    = ln(sigma_j / sigma_j0)                      log-scale of noise parameter j against where the search starts
//! L(x)   = sum_k ln p(nu_k; S_k)                        over all innovations of all recordings                     (1)
//! p      = (1 - e) N(nu; 0, S) + e N(nu; 0, K^2 S)      e = 0.01, K = 10                                           (2)
//! x^     = argmax L(x) - sum_j x_j^2 / (2 ln(3)^2)      by polling along the axes, no derivative                   (3)
//! var x_j ~ -1 / (second derivative of that by x_j)     with the other parameters held                             (4)
//! rho(1) = sum_k u_k u_k-1 / sum_k u_k^2                u_ki = nu_ki / sqrt(S_kii), per source; white: 0           (5)
//! ```
//! The second term of (3) is a prior: the start values are correct within a factor of three. It weighs as much as one or two
//! observations, so parameters determined by the data are hardly affected, and the others keep their start values.
//!
//! Equation (2) is the normal density with one observation in a hundred as an outlier of ten times the sigma: rejected observations
//! count, so that rejecting them gains nothing, and a few gross outliers do not dominate.
//!
//! Data that the search did not use then select the step length from the start towards x^: the module `folds` has the equations.
//!
//! # Source
//! (1): F. C. Schweppe, Evaluation of likelihood functions for Gaussian signals, IEEE Trans. Inform. Theory 11(1), 1965.
//! (2): P. J. Huber, Robust estimation of a location parameter, Ann. Math. Statist. 35(1), 1964.
//! (3): R. Hooke, T. A. Jeeves, "Direct search" solution of numerical and statistical problems, J. ACM 8(2), 1961.

mod folds;
mod keys;
mod likelihood;
mod search;

pub use self::folds::{
    ChoiceReason, FitQuality, FoldScore, QualityLoss, SHARES, ShareChoice, TimeBlocks, blocks_per_run, choose,
    fold_count,
};
pub use self::keys::{NOISE_KEYS, NoiseKey, TunedKey, UnknownKey, default_keys};
pub use self::likelihood::{
    PRIOR_SIGMA, RunFit, SourceFit, SyntheticFixes, fit_in_blocks, fit_run, fixes_from_truth, ln_prior, offline_params,
};
pub use self::search::{SearchOptions, SearchResult, SearchRound, maximise};
