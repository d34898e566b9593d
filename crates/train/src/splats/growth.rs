//! More splats where the images need them, fewer where they are transparent (adaptive density control of Kerbl et al.
//! 2023, §5.2, with a fixed rate of growth).
//!
//! A splat's *demand* is the mean length of ∂L/∂m over the steps that showed it. Every interval the splats of the
//! largest demand become two each: the longest axis of both shrinks, and they move apart along it. Splats that have
//! become nearly transparent go.

use glam::Vec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::cloud::{LOGIT, MEAN, Row, SCALE, WIDTH, opacity, rotation, three};

/// Steps between two changes of the number of splats.
pub const INTERVAL: u64 = 100;
/// Share of a run after which the number stays.
pub const UNTIL: f64 = 0.6;
/// One splat in so many becomes two.
const PART: usize = 12;
/// Least opacity of a splat that stays.
const TRANSPARENT: f32 = 0.01;
/// Change of the logarithms of the deviations of a splat that becomes two.
const SHRINK: f32 = -0.35;
/// Deviations by which each of the two moves.
const SPLIT_DISTANCE: f32 = 0.7;

/// How strongly images pull at a splat: the sum of the lengths of ∂L/∂m, and the number of steps that showed it.
pub type Asked = [f32; 2];

/// The splats and what is kept for each.
pub struct Crowd<'a> {
    pub rows: &'a mut Vec<Row>,
    pub means: &'a mut Vec<Row>,
    pub squares: &'a mut Vec<Row>,
    pub asked: &'a mut Vec<Asked>,
}

impl Crowd<'_> {
    /// Removes transparent splats, if any others are there, and splits those of the largest demand, up to `most`
    /// splats. Begins to count anew.
    pub fn change(self, most: usize, seed: u64, step: u64) {
        let is_kept: Vec<bool> = self.rows.iter().map(|row| opacity(row) >= TRANSPARENT).collect();
        if is_kept.contains(&true) {
            for rows in [&mut *self.rows, &mut *self.means, &mut *self.squares] {
                let mut kept = is_kept.iter();
                rows.retain(|_| kept.next() == Some(&true));
            }
            let mut kept = is_kept.iter();
            self.asked.retain(|_| kept.next() == Some(&true));
        }
        let count = self.rows.len().div_ceil(PART).min(most.saturating_sub(self.rows.len()));
        let mean = |i: usize| self.asked[i][0] / self.asked[i][1].max(1.0);
        let mut order: Vec<usize> = (0..self.rows.len()).filter(|&i| mean(i) > 0.0).collect();
        order.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
        order.truncate(count);
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5911);
        rng.set_stream(step);
        for i in order {
            let child = split(&mut self.rows[i], &mut rng);
            self.rows.push(child);
            for moments in [&mut *self.means, &mut *self.squares] {
                moments[i] = [0.0; WIDTH];
                moments.push([0.0; WIDTH]);
            }
        }
        self.asked.clear();
        self.asked.resize(self.rows.len(), [0.0; 2]);
    }
}

/// Shrinks a splat and moves it; returns its twin, on the other side of where it was.
fn split(row: &mut Row, rng: &mut ChaCha8Rng) -> Row {
    // About normal: the sum of three uniform numbers with variance 1.
    let mut normal = || (0..3).map(|_| rng.random_range(-1.0..1.0_f32)).sum::<f32>();
    let along = Vec3::from_array(std::array::from_fn(|_| normal()));
    let away = SPLIT_DISTANCE * (rotation(row) * (along * three(row, SCALE).exp()));
    let mean = three(row, MEAN);
    (SCALE..LOGIT).take(3).for_each(|k| row[k] += SHRINK);
    let mut twin = *row;
    row[MEAN..MEAN + 3].copy_from_slice(&(mean + away).to_array());
    twin[MEAN..MEAN + 3].copy_from_slice(&(mean - away).to_array());
    twin
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adam's moments belong to a splat: they move with those that stay, and begin at 0 for both of those that came
    /// from one, whose parameters are new.
    #[test]
    fn moments_follow_their_splats_and_begin_anew_where_one_becomes_two() {
        // The second is transparent; the fourth has the largest demand.
        let logits = [2.0, -9.0, 1.0, 0.5, 3.0];
        let row = |(k, logit): (f32, f32)| {
            let mut row = [0.0; WIDTH];
            (row[MEAN], row[LOGIT - 1], row[LOGIT]) = (k, 1.0, logit);
            row
        };
        let mut rows: Vec<Row> = (0..5_u8).map(f32::from).zip(logits).map(row).collect();
        let moments = |factor: f32| (1..=5_u8).map(|k| [factor * f32::from(k); WIDTH]).collect::<Vec<Row>>();
        let (mut means, mut squares) = (moments(1.0), moments(10.0));
        let mut asked = vec![[1.0, 10.0], [9.0, 1.0], [2.0, 10.0], [8.0, 10.0], [3.0, 10.0]];
        let crowd = Crowd { rows: &mut rows, means: &mut means, squares: &mut squares, asked: &mut asked };
        crowd.change(100, 0, 100);
        // A twelfth of four, rounded up, became two.
        assert_eq!((rows.len(), rows[0][MEAN], rows[1][MEAN], rows[3][MEAN]), (5, 0.0, 2.0, 4.0));
        assert!(rows[2][SCALE] == SHRINK && rows[4][SCALE] == SHRINK);
        assert!((rows[2][MEAN] + rows[4][MEAN] - 6.0).abs() < 1e-5, "on both sides of where it was");
        assert_eq!(asked, [[0.0; 2]; 5]);
        for (moments, factor) in [(means, 1.0), (squares, 10.0)] {
            let found: Vec<f32> = moments.iter().map(|row| row[0]).collect();
            assert_eq!(found, [1.0, 3.0, 0.0, 5.0, 0.0].map(|k| k * factor));
            assert!(moments.iter().all(|row| row.iter().all(|entry| *entry == row[0])), "all entries of a splat");
        }
    }
}
