//! How far rounding may take a vertex from the surface, where nobody says.
//!
//! Rounding adds to the distance from the input as independent errors do. A third of what the finest level is off anyway
//! adds a few hundredths to it; half of that distance adds a tenth, which the input's noise may hide. Both are found
//! with the finest tolerance first; what is found is then refined once more with the tolerance that follows.

/// The finest that is taken, the precision of 32-bit floats, in diagonals of the bounding box. Others are this doubled a
/// few times, at most so often: grids of the finest are then grids of all.
pub const FINEST: f64 = 5e-8;
pub const MOST_DOUBLINGS: u32 = 14;

/// Parts of the root of the mean squared distance of the finest level, the larger one at most where there is noise; of the
/// noise; and of the largest distance allowed. What is met exactly stays exact: large triangles can pass for noise.
const OF_DISTANCE: f64 = 1.0 / 3.0;
const MOST_OF_DISTANCE: f64 = 1.0 / 2.0;
const OF_NOISE: f64 = 0.1;
const OF_BOUND: f64 = 1.0 / 16.0;

/// Where a tolerance comes from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Source {
    Given,
    /// How far the finest level is from the input anyway.
    Distance,
    /// What the input's vertices are off a smooth surface.
    Noise,
    /// The largest distance allowed.
    Bound,
    /// There is nothing to be had from a coarser one.
    Precision,
}

/// A tolerance, in diagonals of the bounding box.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Tolerance {
    pub relative: f64,
    pub source: Source,
}

impl Tolerance {
    /// The finest, doubled so often.
    pub fn doubled(doublings: u32, source: Source) -> Self {
        let source = if doublings == 0 { Source::Precision } else { source };
        Self { relative: FINEST * f64::from(1u32 << doublings), source }
    }
}

/// How often to double the finest tolerance, and what says so; lengths in diagonals, a `bound` of 0 for none.
pub fn doublings(distance: f64, noise: f64, bound: f64) -> (u32, Source) {
    let by_noise = (OF_NOISE * noise).min(MOST_OF_DISTANCE * distance);
    let (wanted, source) = if by_noise > OF_DISTANCE * distance {
        (by_noise, Source::Noise)
    } else {
        (OF_DISTANCE * distance, Source::Distance)
    };
    // The nearest on a scale of ratios, but none beyond the bound.
    let nearest = |most: f64, slack: f64| {
        (0..=MOST_DOUBLINGS).rev().find(|&k| FINEST * f64::from(1u32 << k) <= slack * most).unwrap_or(0)
    };
    let wanted = nearest(wanted, std::f64::consts::SQRT_2);
    let most = if bound > 0.0 { nearest(OF_BOUND * bound, 1.0) } else { MOST_DOUBLINGS };
    if most < wanted { (most, Source::Bound) } else { (wanted, source) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_about_a_third_of_the_distance_and_never_beyond_the_bound() {
        for distance in [1e-6, 3e-5, 1e-4, 2e-3] {
            let (doublings, source) = doublings(distance, 0.0, 0.0);
            assert_eq!(source, Source::Distance);
            assert!((0.23..0.48).contains(&(Tolerance::doubled(doublings, source).relative / distance)));
        }
        assert_eq!(doublings(1e-6, 1e-3, 0.0).1, Source::Noise);
        let (few, source) = doublings(1e-2, 1e-3, 1e-4);
        assert_eq!(source, Source::Bound);
        assert!(Tolerance::doubled(few, source).relative <= 1e-4 / 16.0);
    }

    #[test]
    fn what_is_exact_stays_exact_and_nothing_is_ruined() {
        let (none, source) = doublings(0.0, 1e-3, 0.0);
        assert_eq!(
            Tolerance::doubled(none, source),
            Tolerance { relative: FINEST, source: Source::Precision }
        );
        let (all, source) = doublings(1.0, 0.0, 0.0);
        assert!(Tolerance::doubled(all, source).relative < 1e-3);
    }
}
