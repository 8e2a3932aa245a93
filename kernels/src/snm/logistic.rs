//! Logarithm, logit and its inverse, from +, −, × and ÷ alone. All machines round these alike, whereas
//! library functions differ in the last bit between systems.

const LOGIT_TABLE_SIZE: usize = 4096;

/// ln(p / (1 − p)) at the centres of [`LOGIT_TABLE_SIZE`] intervals of 0..1.
static LOGITS: [f32; LOGIT_TABLE_SIZE] = {
    let mut table = [0.0; LOGIT_TABLE_SIZE];
    let mut i = 0;
    while i < LOGIT_TABLE_SIZE {
        let p = (i as f64 + 0.5) / LOGIT_TABLE_SIZE as f64;
        table[i] = natural_log(p / (1.0 - p)) as f32;
        i += 1;
    }
    table
};

/// Maximum magnitude of logits; larger ones are clamped.
const MAX_LOGIT: f32 = 12.0;
const KNOTS_PER_UNIT: usize = 32;

/// 1 / (1 + e^−x) at multiples of 1 / [`KNOTS_PER_UNIT`], from −[`MAX_LOGIT`] on.
static PROBABILITIES: [f32; 2 * MAX_LOGIT as usize * KNOTS_PER_UNIT + 2] = {
    let mut table = [0.0; 2 * MAX_LOGIT as usize * KNOTS_PER_UNIT + 2];
    let mut i = 0;
    // e^(1/32) and e^12 from their series.
    let step = exponential(1.0 / KNOTS_PER_UNIT as f64);
    let mut inverse_odds = exponential(MAX_LOGIT as f64);
    while i < table.len() {
        table[i] = (1.0 / (1.0 + inverse_odds)) as f32;
        inverse_odds /= step;
        i += 1;
    }
    table
};

const fn exponential(x: f64) -> f64 {
    let (mut sum, mut term, mut k) = (1.0, 1.0, 1);
    while k < 80 {
        term *= x / k as f64;
        sum += term;
        k += 1;
    }
    sum
}

/// Compute the natural logarithm: halve or double into 2/3..4/3, then use the series of the inverse
/// hyperbolic tangent.
const fn natural_log(x: f64) -> f64 {
    let (mut m, mut halvings) = (x, 0.0);
    while m > 4.0 / 3.0 {
        m /= 2.0;
        halvings += 1.0;
    }
    while m < 2.0 / 3.0 {
        m *= 2.0;
        halvings -= 1.0;
    }
    let z = (m - 1.0) / (m + 1.0);
    let (mut sum, mut power, mut k) = (0.0, z, 1.0);
    while k < 16.0 {
        sum += power / k;
        power *= z * z;
        k += 2.0;
    }
    halvings * std::f64::consts::LN_2 + 2.0 * sum
}

/// Look up the logit of a probability in 0..1.
pub(super) fn logit(p: f32) -> f32 {
    LOGITS[((p * LOGIT_TABLE_SIZE as f32) as usize).min(LOGIT_TABLE_SIZE - 1)]
}

/// Interpolate the probability of a logit, the inverse of [`logit`].
pub(super) fn sigmoid(logit: f32) -> f32 {
    let x = (logit.clamp(-MAX_LOGIT, MAX_LOGIT) + MAX_LOGIT) * KNOTS_PER_UNIT as f32;
    let i = x as usize;
    let t = x - i as f32;
    PROBABILITIES[i] + t * (PROBABILITIES[i + 1] - PROBABILITIES[i])
}

/// Compute the natural logarithm of a positive normal number, to 1e-4.
pub(super) fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let m = f32::from_bits(bits & 0x007f_ffff | 127 << 23);
    // Same series, centred at √2 so that |z| is below 0.172.
    let z = (m - std::f32::consts::SQRT_2) / (m + std::f32::consts::SQRT_2);
    let square = z * z;
    let series = 2.0 * z * (1.0 + square * (1.0 / 3.0 + square * 0.2));
    (exponent as f32 + 0.5) * std::f32::consts::LN_2 + series
}

/// Classify a number into one of `count` classes: class 0 up to 1, then `per_octave` classes per doubling.
pub(super) fn classify(x: f32, per_octave: f32, count: usize) -> usize {
    ((ln(x) * per_octave * std::f32::consts::LOG2_E) as usize).min(count - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_library() {
        for i in 1..1000 {
            let p = i as f32 / 1000.0;
            let exact = (f64::from(p) / (1.0 - f64::from(p))).ln();
            // A table interval is 1/4096 wide, and the slope of the logit is 1 / p(1 − p).
            let slope = 1.0 / f64::from(p * (1.0 - p));
            assert!((f64::from(logit(p)) - exact).abs() < slope / 4096.0, "{p}");
            assert!((sigmoid(exact as f32) - p).abs() < 3e-5, "{p}");
        }
        assert!(sigmoid(-99.0) > 0.0 && sigmoid(99.0) <= 1.0);
        for x in [1e-6f32, 0.3, 1.0, 1.999_999, 2.0, 17.5, 4e9] {
            assert!((ln(x) - x.ln()).abs() < 1e-4, "{x}");
        }
    }
}
