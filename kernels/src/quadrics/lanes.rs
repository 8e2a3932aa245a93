//! SIMD lanes: each operation applies to all lanes and gives the same bits as the scalar operation.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// N numbers that are processed together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lanes<const N: usize>(pub [f64; N]);

/// One vector per lane.
pub type LaneVec3<const N: usize> = [Lanes<N>; 3];

impl<const N: usize> Lanes<N> {
    pub const ZERO: Self = Self([0.0; N]);

    /// Set all lanes to one value.
    #[inline]
    pub fn all(x: f64) -> Self {
        Self([x; N])
    }

    #[inline]
    pub fn sqrt(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }
}

impl<const N: usize> Add for Lanes<N> {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl<const N: usize> Sub for Lanes<N> {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - other.0[i]))
    }
}

impl<const N: usize> Mul for Lanes<N> {
    type Output = Self;

    #[inline]
    fn mul(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * other.0[i]))
    }
}

impl<const N: usize> Div for Lanes<N> {
    type Output = Self;

    #[inline]
    fn div(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] / other.0[i]))
    }
}

impl<const N: usize> Neg for Lanes<N> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self(self.0.map(|x| -x))
    }
}

#[inline]
pub fn dot<const N: usize>(a: &LaneVec3<N>, b: &LaneVec3<N>) -> Lanes<N> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub fn sub<const N: usize>(a: &LaneVec3<N>, b: &LaneVec3<N>) -> LaneVec3<N> {
    std::array::from_fn(|i| a[i] - b[i])
}

#[inline]
pub fn cross<const N: usize>(a: &LaneVec3<N>, b: &LaneVec3<N>) -> LaneVec3<N> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
