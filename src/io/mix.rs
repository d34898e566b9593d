//! Numbers that look random, from numbers.

/// SplitMix64's finaliser (Steele et al. 2014): a bijection in which every input bit affects all output bits.
#[must_use]
pub fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// Point `n` of a sequence that fills the unit square evenly: R₂ (Roberts 2018).
#[must_use]
pub fn evenly(n: usize) -> [f64; 2] {
    [0.754_877_666_246_693, 0.569_840_290_998_053_3].map(|step| (0.5 + (n + 1) as f64 * step).fract())
}
