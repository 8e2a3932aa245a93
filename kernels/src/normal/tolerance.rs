//! Default quantisation tolerance, derived from the mesh.
//!
//! Rounding adds to the distance from the input like an independent error. A tolerance of 1/3 of the finest
//! level's RMS distance raises that distance by at most 5 %. A tolerance of 1/2 raises it by at most 12 %,
//! which the input's noise may hide. The distance is first measured with the finest tolerance; the refinement
//! is then repeated with the derived one.

/// Finest tolerance, in diagonals of the bounding box: the precision of 32-bit floats. All others are
/// power-of-two multiples up to the given number of doublings. Points of a coarser grid are thus points of
/// the finest grid.
pub const FINEST_TOLERANCE: f64 = 5e-8;
pub const MAX_DOUBLINGS: u32 = 14;

/// Tolerance as a fraction of: the finest level's RMS distance; the same as upper limit with noise; the
/// noise; and the maximum error. The noise term is limited because large triangles pass for noise, and an
/// exact fit must stay exact.
const DISTANCE_RATIO: f64 = 1.0 / 3.0;
const MAX_DISTANCE_RATIO: f64 = 1.0 / 2.0;
const NOISE_RATIO: f64 = 0.1;
const BOUND_RATIO: f64 = 1.0 / 16.0;

/// Origin of a tolerance.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ToleranceSource {
    Given,
    /// Derived from the distance between the finest level and the input.
    Distance,
    /// Derived from the noise of the input's vertices.
    Noise,
    /// Limited by the requested maximum error.
    Bound,
    /// Finest tolerance, because a coarser one would gain nothing.
    Precision,
}

/// Tolerance in diagonals of the bounding box.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Tolerance {
    pub relative: f64,
    pub source: ToleranceSource,
}

impl Tolerance {
    /// Double the finest tolerance `choose_doublings` times.
    pub fn from_doublings(doublings: u32, source: ToleranceSource) -> Self {
        let source = if doublings == 0 { ToleranceSource::Precision } else { source };
        Self { relative: FINEST_TOLERANCE * f64::from(1u32 << doublings), source }
    }
}

/// Derive the number of doublings of the finest tolerance, and the reason for it. All lengths are in
/// diagonals; a `bound` of 0 means no limit.
pub fn choose_doublings(distance: f64, noise: f64, bound: f64) -> (u32, ToleranceSource) {
    let by_noise = (NOISE_RATIO * noise).min(MAX_DISTANCE_RATIO * distance);
    let (wanted, source) = if by_noise > DISTANCE_RATIO * distance {
        (by_noise, ToleranceSource::Noise)
    } else {
        (DISTANCE_RATIO * distance, ToleranceSource::Distance)
    };
    // Round to the nearest power of two, but never above the bound.
    let nearest = |most: f64, slack: f64| {
        (0..=MAX_DOUBLINGS)
            .rev()
            .find(|&k| FINEST_TOLERANCE * f64::from(1u32 << k) <= slack * most)
            .unwrap_or(0)
    };
    let wanted = nearest(wanted, std::f64::consts::SQRT_2);
    let most = if bound > 0.0 { nearest(BOUND_RATIO * bound, 1.0) } else { MAX_DOUBLINGS };
    if most < wanted { (most, ToleranceSource::Bound) } else { (wanted, source) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_about_a_third_of_the_distance_and_never_beyond_the_bound() {
        for distance in [1e-6, 3e-5, 1e-4, 2e-3] {
            let (doublings, source) = choose_doublings(distance, 0.0, 0.0);
            assert_eq!(source, ToleranceSource::Distance);
            assert!(
                (0.23..0.48).contains(&(Tolerance::from_doublings(doublings, source).relative / distance))
            );
        }
        assert_eq!(choose_doublings(1e-6, 1e-3, 0.0).1, ToleranceSource::Noise);
        let (few, source) = choose_doublings(1e-2, 1e-3, 1e-4);
        assert_eq!(source, ToleranceSource::Bound);
        assert!(Tolerance::from_doublings(few, source).relative <= 1e-4 / 16.0);
    }

    #[test]
    fn what_is_exact_stays_exact_and_nothing_is_ruined() {
        let (none, source) = choose_doublings(0.0, 1e-3, 0.0);
        assert_eq!(
            Tolerance::from_doublings(none, source),
            Tolerance { relative: FINEST_TOLERANCE, source: ToleranceSource::Precision }
        );
        let (all, source) = choose_doublings(1.0, 0.0, 0.0);
        assert!(Tolerance::from_doublings(all, source).relative < 1e-3);
    }
}
