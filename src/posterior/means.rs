//! Binomial means of numbers at lattice points, block by block.
//!
//! `T` is the mean with weights ¼, ½, ¼ along each axis, and T^k k such means. Along one axis, T^k has binomial weights
//! over 2k + 1 points. `D_k` has the weights of k − 1 means and then half a central difference, ¼ (f(x + 1) −
//! f(x − 1)): of f = exp(a x), D_k f = tanh(a/2) T^k f.

use multiversion::multiversion;

pub(super) use crate::octree::BLOCK;

/// Points around a block that its means depend on: T⁴ reaches the bricks around it.
pub const HALO: u32 = crate::octree::BRICK;
/// Points along an axis of what the means of a block are computed from.
pub const SIDE: u32 = BLOCK + 2 * HALO;

/// `[16³]`, x fastest: one number at every point of a block and of its halo.
pub type Numbers = Vec<f32>;
/// `[8³]`, x fastest: one number at every point of a block.
pub type BlockNumbers = Vec<f32>;

/// The weights of T^k and of D_k along an axis, at −k, …, k.
pub struct Order {
    /// k.
    pub k: i32,
    mean: &'static [f32],
    difference: &'static [f32],
}

/// T, and D_1.
pub const FIRST: Order = Order { k: 1, mean: &[0.25, 0.5, 0.25], difference: &[-0.25, 0.0, 0.25] };
/// T⁴, and D_4.
pub const FOURTH: Order = Order {
    k: 4,
    mean: &over_256([1.0, 8.0, 28.0, 56.0, 70.0, 56.0, 28.0, 8.0, 1.0]),
    difference: &over_256([-1.0, -6.0, -14.0, -14.0, 0.0, 14.0, 14.0, 6.0, 1.0]),
};

const fn over_256(mut weights: [f32; 9]) -> [f32; 9] {
    let mut i = 0;
    while i < weights.len() {
        weights[i] /= 256.0;
        i += 1;
    }
    weights
}

/// From a point to the next along x, y and z, while the axes before it are as long as a cube's.
const STRIDES: [usize; 3] = [1, SIDE as usize, (SIDE * SIDE) as usize];

/// T^k.
pub fn mean(numbers: &Numbers, order: &Order) -> BlockNumbers {
    let [x, y, z] = STRIDES;
    along(&along(&along(numbers, z, order.mean), y, order.mean), x, order.mean)
}

/// T^k, and along each axis D_k, which the other two average.
pub struct Slopes {
    /// T^k.
    pub mean: BlockNumbers,
    /// D_k along x, y and z.
    pub differences: [BlockNumbers; 3],
}

impl Slopes {
    /// Of numbers, with the weights of `order`.
    pub fn new(numbers: &Numbers, order: &Order) -> Self {
        let [x, y, z] = STRIDES;
        let Order { mean, difference, .. } = order;
        let of_z = along(numbers, z, mean);
        let of_yz = along(&of_z, y, mean);
        let differences = [
            along(&of_yz, x, difference),
            along(&along(&of_z, y, difference), x, mean),
            along(&along(&along(numbers, z, difference), y, mean), x, mean),
        ];
        Self { mean: along(&of_yz, x, mean), differences }
    }
}

/// Sums with an odd number of weights along the axis of this stride, which becomes as short as a block.
#[multiversion(targets("x86_64+avx2+fma"))]
fn along(numbers: &[f32], stride: usize, weights: &[f32]) -> Vec<f32> {
    /// Sums that are computed together: divides every length.
    const LANES: usize = 8;
    let first = (HALO as usize - weights.len() / 2) * stride;
    let mut sums = vec![0.0; numbers.len() / 2];
    let lines = sums.chunks_exact_mut(BLOCK as usize * stride).zip(numbers.chunks_exact(SIDE as usize * stride));
    for (sums, numbers) in lines {
        for (at, to) in sums.chunks_exact_mut(LANES).enumerate() {
            let mut sum = [0.0_f32; LANES];
            for (i, weight) in weights.iter().enumerate() {
                let from = &numbers[first + i * stride + at * LANES..][..LANES];
                sum.iter_mut().zip(from).for_each(|(sum, number)| *sum += weight * number);
            }
            to.copy_from_slice(&sum);
        }
    }
    sums
}
