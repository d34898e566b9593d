//! Forward-mode automatic differentiation in f64: a number and its gradient by position.

use std::ops::{Add, Div, Mul, Neg, Sub};

use glam::DVec3;

/// A value with its derivatives ∂/∂x, ∂/∂y, ∂/∂z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual {
    pub value: f64,
    pub gradient: DVec3,
}

impl Dual {
    pub fn constant(value: f64) -> Self {
        Self { value, gradient: DVec3::ZERO }
    }

    /// The three coordinates of a point.
    pub fn position(x: DVec3) -> [Self; 3] {
        [0, 1, 2].map(|axis| Self { value: x[axis], gradient: DVec3::AXES[axis] })
    }

    fn chain(self, value: f64, slope: f64) -> Self {
        Self { value, gradient: slope * self.gradient }
    }

    pub fn sin(self) -> Self {
        self.chain(self.value.sin(), self.value.cos())
    }

    pub fn sigmoid(self) -> Self {
        let s = 1.0 / (1.0 + (-self.value).exp());
        self.chain(s, s * (1.0 - s))
    }

    /// The slope at 0 is set to 0: a distance has none there.
    pub fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }

    pub fn abs(self) -> Self {
        if self.value < 0.0 { -self } else { self }
    }

    pub fn max(self, other: f64) -> Self {
        if self.value < other { Self::constant(other) } else { self }
    }

    pub fn min(self, other: f64) -> Self {
        if self.value > other { Self::constant(other) } else { self }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, gradient: self.gradient + other.gradient }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, gradient: -self.gradient }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, gradient: self.value * other.gradient + other.value * self.gradient }
    }
}

impl Mul<f64> for Dual {
    type Output = Self;
    fn mul(self, k: f64) -> Self {
        self.chain(self.value * k, k)
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let q = self.value / other.value;
        Self { value: q, gradient: (self.gradient - q * other.gradient) / other.value }
    }
}
