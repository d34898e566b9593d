//! Numbers of every vertex, in as few bytes as they need: σ in f32, counts of rays in one byte.

/// Numbers by vertex, stored as `S`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ByVertex<S>(pub(super) Vec<S>);

/// Standard deviations by vertex, scene units.
///
/// They are computed in f64 and stored in f32, which changes log10 σ by at most 3e-8.
pub type StandardDeviations = ByVertex<f32>;

/// Ray counts by vertex, exact up to 16 and within 1/16 of themselves above.
///
/// A byte is a floating-point number: counts below 8 are themselves, others (8 + m) · 2^e with three bits of m and
/// five of e. Support is a matter of magnitude, and a byte beside the four of a deviation is cheap.
pub type RayCounts = ByVertex<u8>;

/// A number in fewer bytes than it is read as.
pub trait Stored: Copy {
    /// What it is read as.
    type Number;
    /// The number.
    fn number(self) -> Self::Number;
}

impl Stored for f32 {
    type Number = f64;
    fn number(self) -> f64 {
        f64::from(self)
    }
}

impl Stored for u8 {
    type Number = u64;
    fn number(self) -> u64 {
        decode(self)
    }
}

impl<S> From<Vec<S>> for ByVertex<S> {
    fn from(stored: Vec<S>) -> Self {
        Self(stored)
    }
}

impl FromIterator<u32> for RayCounts {
    fn from_iter<T: IntoIterator<Item = u32>>(counts: T) -> Self {
        Self(counts.into_iter().map(encode).collect())
    }
}

impl<S: Stored> ByVertex<S> {
    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no vertices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The number of vertex `v`.
    #[must_use]
    pub fn get(&self, v: usize) -> S::Number {
        self.0[v].number()
    }

    /// The numbers of all vertices.
    #[must_use]
    pub fn iter(&self) -> impl ExactSizeIterator<Item = S::Number> + '_ {
        self.0.iter().map(|stored| stored.number())
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.0.capacity() * size_of::<S>()
    }
}

/// The code of the nearest count that has one; of two, the larger.
pub(super) fn encode(count: u32) -> u8 {
    if count < 16 {
        return count as u8;
    }
    // The leading bit and the three that follow, rounded; a carry moves to the next power of two by itself.
    let exponent = count.ilog2() - 3;
    let rounded = (u64::from(count) + (1 << (exponent - 1))) >> exponent;
    (8 * u64::from(exponent) + rounded) as u8
}

/// The count of a code.
pub(super) fn decode(code: u8) -> u64 {
    let code = u64::from(code);
    if code < 16 { code } else { (8 + code % 8) << (code / 8 - 1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn counts_are_kept_to_a_sixteenth(count in 0_u32.., bits in 0_u32..32) {
            let count = count >> bits;
            let found = decode(encode(count));
            let off = found.abs_diff(u64::from(count));
            prop_assert!(16 * off <= u64::from(count), "{} became {}", count, found);
            prop_assert!(count > 16 || off == 0);
        }
    }

    #[test]
    fn codes_and_counts_correspond() {
        // Larger counts than u32 holds have no code that is needed.
        for code in 0..=239 {
            assert_eq!(encode(decode(code) as u32), code);
        }
        assert!((0..255).all(|code| decode(code) < decode(code + 1)));
        // The bound is not idle: half-way between 16 and 18.
        assert_eq!((decode(encode(17)), decode(encode(u32::MAX))), (18, 1 << 32));
    }
}
