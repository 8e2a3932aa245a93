//! SIMD lanes: each operation applies to all lanes and gives the same bits as the scalar operation.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// N numbers that are processed together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lanes<const N: usize, T = f64>(pub [T; N]);

/// One vector per lane.
pub type LaneVec3<const N: usize, T = f64> = [Lanes<N, T>; 3];

impl<const N: usize> Lanes<N> {
    pub const ZERO: Self = Self([0.0; N]);
}

impl<const N: usize, T: Copy> Lanes<N, T> {
    /// Set all lanes to one value.
    #[inline]
    pub fn all(x: T) -> Self {
        Self([x; N])
    }

    /// Apply a function to each lane.
    #[inline]
    pub fn map(self, function: impl Fn(T) -> T) -> Self {
        Self(self.0.map(function))
    }
}

impl<const N: usize, T: Copy + Add<Output = T>> Add for Lanes<N, T> {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl<const N: usize, T: Copy + Add<Output = T>> AddAssign for Lanes<N, T> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const N: usize, T: Copy + Sub<Output = T>> Sub for Lanes<N, T> {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - other.0[i]))
    }
}

impl<const N: usize, T: Copy + Mul<Output = T>> Mul for Lanes<N, T> {
    type Output = Self;

    #[inline]
    fn mul(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * other.0[i]))
    }
}

impl<const N: usize, T: Copy + Div<Output = T>> Div for Lanes<N, T> {
    type Output = Self;

    #[inline]
    fn div(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] / other.0[i]))
    }
}

impl<const N: usize, T: Copy + Neg<Output = T>> Neg for Lanes<N, T> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self(self.0.map(|x| -x))
    }
}

#[inline]
pub fn dot<const N: usize, T>(a: &LaneVec3<N, T>, b: &LaneVec3<N, T>) -> Lanes<N, T>
where
    T: Copy + Add<Output = T> + Mul<Output = T>,
{
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub fn sub<const N: usize, T>(a: &LaneVec3<N, T>, b: &LaneVec3<N, T>) -> LaneVec3<N, T>
where
    T: Copy + Sub<Output = T>,
{
    std::array::from_fn(|i| a[i] - b[i])
}

#[inline]
pub fn cross<const N: usize, T>(a: &LaneVec3<N, T>, b: &LaneVec3<N, T>) -> LaneVec3<N, T>
where
    T: Copy + Sub<Output = T> + Mul<Output = T>,
{
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
