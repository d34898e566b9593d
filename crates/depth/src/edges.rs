//! Where a rendered depth jumps.

use octobayes::render::RenderedView;

/// Farther from a jump than so many pixels, it does not matter how far.
const FARTHEST: u32 = 15;

/// `[height · width]`: pixels to the nearest one beside a jump of the median depth by more than `jump` (a share of the
/// nearer depth), or beside a pixel that shows nothing: 0 on the jump itself, at most [`FARTHEST`].
///
/// The distance is the larger of that along x and that along y.
pub(crate) fn pixels_to_edge(view: &RenderedView, jump: f64) -> Vec<u32> {
    let [width, height] = view.resolution.map(|n| n as usize);
    let depth = |x: usize, y: usize| {
        let pixel = &view.pixels[y * width + x];
        if pixel.opacity > 0.5 { pixel.median_depth } else { f64::INFINITY }
    };
    let differs = |a: f64, b: f64| a != b && (a - b).abs() > jump * a.min(b);
    let mut distance = vec![FARTHEST; width * height];
    for y in 0..height {
        for x in 0..width {
            let own = depth(x, y);
            let beside = [(x + 1 < width).then(|| (x + 1, y)), (y + 1 < height).then(|| (x, y + 1))];
            for (x_beside, y_beside) in beside.into_iter().flatten() {
                if differs(own, depth(x_beside, y_beside)) {
                    (distance[y * width + x], distance[y_beside * width + x_beside]) = (0, 0);
                }
            }
        }
    }
    chessboard(&mut distance, width, height);
    distance
}

/// Chessboard distances by two passes (Rosenfeld & Pfaltz 1966): exact for this metric.
fn chessboard(distance: &mut [u32], width: usize, height: usize) {
    let step = |distance: &mut [u32], [x, y]: [usize; 2], beside: [[isize; 2]; 4]| {
        let of = |[dx, dy]: [isize; 2]| {
            let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            (x < width && y < height).then(|| distance[y * width + x] + 1)
        };
        let nearest = beside.into_iter().filter_map(of).min().unwrap_or(FARTHEST);
        let own = &mut distance[y * width + x];
        *own = nearest.min(*own);
    };
    for y in 0..height {
        for x in 0..width {
            step(distance, [x, y], [[-1, 0], [-1, -1], [0, -1], [1, -1]]);
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            step(distance, [x, y], [[1, 0], [1, 1], [0, 1], [-1, 1]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use octobayes::render::Pixel;

    use super::*;

    #[test]
    fn edges_are_jumps_and_outlines() {
        let (width, height) = (40, 3);
        // A slope, a step at column 10, and nothing from column 30 on.
        let depth = |x: usize| 1.0 + 0.01 * x as f64 + if x >= 10 { 0.2 } else { 0.0 };
        let pixel = |i: usize| {
            let x = i % width;
            Pixel { median_depth: depth(x), opacity: if x < 30 { 1.0 } else { 0.0 }, ..Pixel::default() }
        };
        let pixels = (0..width * height).map(pixel).collect();
        let view = RenderedView { resolution: [width as u32, height as u32], pixels, ..RenderedView::default() };
        let found = pixels_to_edge(&view, 0.05);
        let expected = |x: usize| {
            [9, 10, 29, 30].map(|edge: usize| edge.abs_diff(x) as u32).into_iter().min().unwrap().min(FARTHEST)
        };
        (0..width * height).for_each(|i| assert_eq!(found[i], expected(i % width), "column {}", i % width));
        assert_eq!(pixels_to_edge(&view, 10.0)[10], FARTHEST, "the outline is too far away");
        // Every step of the slope is a jump: what shows nothing is as far away as the slope.
        let steep = pixels_to_edge(&view, 0.005);
        (0..width * height).for_each(|i| assert_eq!(steep[i], (i % width).saturating_sub(30) as u32));
    }
}
