//! XXH64 of Yann Collet with seed 0: the lower half of it is the checksum of a zstd stream (RFC 8878, §3.1.1).

const PRIMES: [u64; 5] =
    [0x9e37_79b1_85eb_ca87, 0xc2b2_ae3d_27d4_eb4f, 0x1656_67b1_9e37_79f9, 0x85eb_ca77_c2b2_ae63, 0x27d4_eb2f_1656_67c5];

const fn round(sum: u64, word: u64) -> u64 {
    sum.wrapping_add(word.wrapping_mul(PRIMES[1])).rotate_left(31).wrapping_mul(PRIMES[0])
}

fn word(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte))
}

/// The checksum of some bytes.
pub(super) fn xxh64(bytes: &[u8]) -> u64 {
    let [first, second, third, fourth, fifth] = PRIMES;
    let (stripes, rest) = bytes.split_at(bytes.len() / 32 * 32);
    let mut sum = fifth;
    if !stripes.is_empty() {
        let mut lanes = [first.wrapping_add(second), second, 0, first.wrapping_neg()];
        for stripe in stripes.chunks_exact(32) {
            for (lane, bytes) in lanes.iter_mut().zip(stripe.chunks_exact(8)) {
                *lane = round(*lane, word(bytes));
            }
        }
        let turned = lanes.iter().zip([1, 7, 12, 18]).map(|(lane, turns)| lane.rotate_left(turns));
        sum = turned.fold(0, u64::wrapping_add);
        for lane in lanes {
            sum = (sum ^ round(0, lane)).wrapping_mul(first).wrapping_add(fourth);
        }
    }
    sum = sum.wrapping_add(bytes.len() as u64);
    let (words, rest) = rest.split_at(rest.len() / 8 * 8);
    for bytes in words.chunks_exact(8) {
        sum = (sum ^ round(0, word(bytes))).rotate_left(27).wrapping_mul(first).wrapping_add(fourth);
    }
    let (half, rest) = rest.split_at(rest.len() / 4 * 4);
    for bytes in half.chunks_exact(4) {
        sum = (sum ^ word(bytes).wrapping_mul(first)).rotate_left(23).wrapping_mul(second).wrapping_add(third);
    }
    for byte in rest {
        sum = (sum ^ u64::from(*byte).wrapping_mul(fifth)).rotate_left(11).wrapping_mul(first);
    }
    sum = (sum ^ sum >> 33).wrapping_mul(second);
    sum = (sum ^ sum >> 29).wrapping_mul(third);
    sum ^ sum >> 32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_the_reference() {
        for (text, expected) in [
            ("", 0xef46_db37_51d8_e999),
            ("a", 0xd24e_c4f1_a98c_6e5b),
            ("abc", 0x44bc_2cf5_ad77_0999),
            ("Nobody inspects the spammish repetition", 0xfbce_a83c_8a37_8bf1),
        ] {
            assert_eq!(xxh64(text.as_bytes()), expected, "{text}");
        }
    }
}
