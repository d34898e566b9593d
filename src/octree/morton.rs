//! Morton codes: the bits of three lattice coordinates interleaved, x in bit 0 of each triple, then y, then z.
//!
//! Sorting by code visits space along a Z-curve. Dropping the low 3 bits gives the parent cell. The low 6
//! bits number the points of an aligned 4³ brick.

/// Morton code of lattice coordinates below 2^21.
#[must_use]
pub fn encode(p: [u32; 3]) -> u64 {
    spread(p[0]) | spread(p[1]) << 1 | spread(p[2]) << 2
}

/// Lattice coordinates of a Morton code.
#[must_use]
pub fn decode(code: u64) -> [u32; 3] {
    [gather(code), gather(code >> 1), gather(code >> 2)]
}

/// Moves bit k of a 21-bit number to bit 3k.
fn spread(v: u32) -> u64 {
    let mut v = u64::from(v) & 0x1f_ffff;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

/// Inverse of [`spread`]; ignores all other bits.
fn gather(v: u64) -> u32 {
    let mut v = v & 0x1249_2492_4924_9249;
    v = (v | v >> 2) & 0x10c3_0c30_c30c_30c3;
    v = (v | v >> 4) & 0x100f_00f0_0f00_f00f;
    v = (v | v >> 8) & 0x001f_0000_ff00_00ff;
    v = (v | v >> 16) & 0x001f_0000_0000_ffff;
    ((v | v >> 32) & 0x1f_ffff) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The definition, bit by bit.
    fn encode_slowly(p: [u32; 3]) -> u64 {
        (0..21).fold(0, |code, bit| {
            (0..3).fold(code, |code, axis| code | u64::from(p[axis] >> bit & 1) << (3 * bit + axis))
        })
    }

    proptest! {
        #[test]
        fn agrees_with_the_definition(x in 0u32..1 << 21, y in 0u32..1 << 21, z in 0u32..1 << 21) {
            prop_assert_eq!(encode([x, y, z]), encode_slowly([x, y, z]));
            prop_assert_eq!(decode(encode([x, y, z])), [x, y, z]);
        }
    }
}
