//! Adaptive probabilities of binary decisions: a prior model mixed with observed contexts.
//!
//! A family of decisions has `F` real features and `N` contexts, each a small number. A logistic regression
//! on the features gives the prior probability. Its initial weights are fitted to real meshes, so even the
//! first vertex of a file gets a fair probability. Every context value has an adaptive probability,
//! initialised with the prior at its first use. Prior and contexts are mixed in the logistic domain (Mahoney,
//! Adaptive weighing of context models for lossless data compression, 2005). Weights are learnt by an
//! extended Kalman filter, which needs few samples: files are small.

use std::num::NonZeroU16;

use super::coder::{Coder, Exhausted};
use super::logistic::{logit, sigmoid};

/// Learning rates of a family of decisions.
#[derive(Clone, Copy)]
pub(super) struct Rates {
    /// Variances of the regression weights and of the mixer weights: initial value, and increase per
    /// decision.
    pub regression: [f32; 2],
    pub mixer: [f32; 2],
    /// Window of a context's probability, in decisions.
    pub memory: u16,
    /// Weight of the prior in a new context, in decisions.
    pub prior_weight: u16,
    /// Minimum distance of probabilities from 0 and 1, in units of 1/65536.
    pub min_probability: u16,
}

#[derive(Clone, Copy)]
struct ContextState {
    probability: f32,
    decision_count: u16,
}

/// Logistic regression with online learning (extended Kalman filter on its weights).
#[derive(Clone, Copy)]
struct Regression<const I: usize> {
    weights: [f32; I],
    /// Covariance of the weights.
    covariance: [[f32; I]; I],
    rates: [f32; 2],
}

impl<const I: usize> Regression<I> {
    fn new(weights: [f32; I], rates: [f32; 2]) -> Self {
        let spread = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { rates[0] } else { 0.0 }));
        Self { weights, covariance: spread, rates }
    }

    fn sum(&self, inputs: &[f32; I]) -> f32 {
        (0..I).map(|i| self.weights[i] * inputs[i]).sum()
    }

    /// Update the weights. `error` is the outcome minus the predicted probability `probability`.
    fn learn(&mut self, inputs: &[f32; I], p: f32, error: f32) {
        let reach: [f32; I] =
            std::array::from_fn(|i| (0..I).map(|j| self.covariance[i][j] * inputs[j]).sum());
        // Rounding must not make it negative.
        let power = (0..I).map(|i| inputs[i] * reach[i]).sum::<f32>().max(0.0);
        let variance = (p * (1.0 - p)).max(0.003);
        let gain = 1.0 / (1.0 + variance * power);
        for i in 0..I {
            self.weights[i] += gain * error * reach[i];
            for j in 0..I {
                self.covariance[i][j] -= gain * variance * reach[i] * reach[j];
            }
            // The variance of unused weights must not grow without limit.
            if self.covariance[i][i] < self.rates[0] {
                self.covariance[i][i] = self.covariance[i][i].max(0.0) + self.rates[1];
            }
        }
    }
}

/// Probabilities of a family of decisions.
pub(super) struct Decisions<const F: usize, const N: usize> {
    rates: Rates,
    regressions: Vec<Regression<F>>,
    mixers: Vec<Regression<N>>,
    slots: [Vec<ContextState>; N],
}

impl<const F: usize, const N: usize> Decisions<F, N> {
    /// Create one decision per row of `regressions`, with contexts of the given sizes.
    pub(super) fn new(rates: Rates, regressions: &[[f32; F]], sizes: [usize; N]) -> Self {
        let mixer = Regression::new([0.6 / (N as f32 + 1.0); N], rates.mixer);
        let slot = ContextState { probability: 0.5, decision_count: 0 };
        Self {
            rates,
            regressions: regressions
                .iter()
                .map(|&weights| Regression::new(weights, rates.regression))
                .collect(),
            mixers: vec![mixer; regressions.len()],
            slots: sizes.map(|size| vec![slot; size * regressions.len()]),
        }
    }

    /// Code one decision of the family, and update its models.
    pub(super) fn code_bit<C: Coder>(
        &mut self,
        coder: &mut C,
        decision: usize,
        features: &[f32; F],
        contexts: &[usize; N],
        bit: bool,
    ) -> Result<bool, Exhausted> {
        let count = self.regressions.len();
        let regression = &mut self.regressions[decision];
        let mixer = &mut self.mixers[decision];
        let guess = regression.sum(features).clamp(-11.0, 11.0);
        let guessed = sigmoid(guess);
        let mut inputs = [0.0; N];
        for i in 0..N {
            let slot = &mut self.slots[i][contexts[i] * count + decision];
            if slot.decision_count == 0 {
                *slot = ContextState { probability: guessed, decision_count: self.rates.prior_weight };
            }
            // Difference of the context from the prior, in logits.
            inputs[i] = logit(slot.probability) - guess;
        }
        let p = sigmoid(guess + mixer.sum(&inputs));
        let bit = coder.code_bit(quantize_probability(p, self.rates.min_probability), bit)?;

        let outcome = f32::from(u8::from(bit));
        regression.learn(features, guessed, outcome - guessed);
        mixer.learn(&inputs, p, outcome - p);
        for (slots, context) in self.slots.iter_mut().zip(contexts) {
            let slot = &mut slots[context * count + decision];
            slot.decision_count = (slot.decision_count + 1).min(self.rates.memory);
            slot.probability += (outcome - slot.probability) / f32::from(slot.decision_count);
        }
        Ok(bit)
    }
}

fn quantize_probability(p: f32, margin: u16) -> NonZeroU16 {
    let p = ((p * 65536.0) as u16).clamp(margin, u16::MAX - margin + 1);
    NonZeroU16::new(p).unwrap_or(NonZeroU16::MIN)
}
