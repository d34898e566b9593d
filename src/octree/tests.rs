//! Properties of the octree, compared with scans over all leaves.

use std::collections::BTreeSet;

use super::arbitrary::octrees;
use super::*;
use proptest::prelude::*;
use rayon::iter::ParallelIterator as _;

/// Lattice coordinates that are often on faces, edges and corners of cells.
fn points(finest: u8) -> impl Strategy<Value = DVec3> {
    let m = 1_u32 << finest;
    let coordinate = prop_oneof![
        (0..=m).prop_map(f64::from),
        (0..2 * m).prop_map(|i| f64::from(i) / 2.0),
        0.0..=f64::from(m),
        (1..=m).prop_map(|i| f64::from(i).next_down()),
    ];
    [coordinate.clone(), coordinate.clone(), coordinate].prop_map(DVec3::from)
}

fn octrees_and_points() -> impl Strategy<Value = (Octree, DVec3)> {
    octrees().prop_flat_map(|octree| {
        let finest = octree.finest();
        (Just(octree), points(finest))
    })
}

fn leaves(octree: &Octree) -> Vec<Cell> {
    let mut leaves = Vec::new();
    octree.cells().for_each_leaf(|leaf| leaves.push(leaf));
    leaves
}

fn interpolate(octree: &Octree, values: &[f64], u: DVec3) -> f64 {
    let at = octree.locate(u);
    at.corners
        .iter()
        .zip(at.weights)
        .map(|(corner, weight)| {
            let masters = corner.masters();
            weight * masters.iter().map(|v| values[v.0 as usize]).sum::<f64>() / masters.len() as f64
        })
        .sum()
}

/// Arbitrary but reproducible vertex values in [0, 1).
fn values(octree: &Octree) -> Vec<f64> {
    octree
        .vertex_positions()
        .map(|p| (f64::from(p[0] * 7919 + p[1] * 104_729 + p[2] * 1_299_709) * 0.618_034).fract())
        .collect()
}

proptest! {
    #[test]
    fn trilinear_weights_are_a_partition_of_unity(x in 0.0..=1.0, y in 0.0..=1.0, z in 0.0..=1.0) {
        let weights = trilinear(DVec3::new(x, y, z));
        prop_assert!(weights.iter().all(|&w| w >= 0.0));
        // Seven additions and eight triple products, each rounded once, stay below 16 ulps of 1.
        prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() <= 16.0 * f64::EPSILON);
    }

    #[test]
    fn every_octree_is_sound(octree in octrees()) {
        let stats = octree.validate();
        prop_assert!(stats.is_ok(), "{:?}", stats);
        prop_assert_eq!(stats.unwrap().leaves(), leaves(&octree).len() as u64);
    }

    #[test]
    fn vertices_are_the_corners_that_do_not_hang(octree in octrees()) {
        let finest = octree.finest();
        let corners = leaves(&octree).into_iter().flat_map(|leaf| {
            let (origin, edge) = leaf.extent(finest);
            (0..8_u32).map(move |c| std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1)))
        });
        let free: BTreeSet<[u32; 3]> = corners.filter(|&point| hanging_on(octree.cells(), point).is_none()).collect();
        prop_assert_eq!(octree.vertex_count(), free.len());
        prop_assert_eq!(octree.vertex_positions().collect::<BTreeSet<_>>(), free);
        let serial: Vec<_> = octree.vertex_positions().collect();
        let parallel: Vec<_> = octree.par_vertex_positions().collect();
        prop_assert_eq!(serial, parallel);
        for point in octree.vertex_positions() {
            let levels = cells_around(point, finest).map(|cell| octree.cells().leaf(cell).level);
            let coarseness = finest - levels.max().unwrap();
            prop_assert_eq!(octree.vertices.find_at(point, coarseness).map(VertexId), octree.vertex(point));
        }
    }

    #[test]
    fn corners_found_together_are_those_found_one_by_one(
        octree in octrees(),
        u in proptest::array::uniform3(0.0..=1.0_f64),
    ) {
        let located = octree.locate(DVec3::from(u) * f64::from(1_u32 << octree.finest()));
        let (origin, edge) = located.leaf.extent(octree.finest());
        for (c, corner) in (0_u32..).zip(located.corners) {
            let point = std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1));
            prop_assert_eq!(corner, octree.corner(point));
        }
    }

    #[test]
    fn locate_agrees_with_a_scan_over_leaves((octree, u) in octrees_and_points()) {
        let m = f64::from(1_u32 << octree.finest());
        let inside = |leaf: &Cell| {
            let (origin, edge) = leaf.extent(octree.finest());
            (0..3).all(|axis| {
                let (lo, hi) = (f64::from(origin[axis]), f64::from(origin[axis] + edge));
                u[axis] >= lo && (u[axis] < hi || (hi == m && u[axis] == m))
            })
        };
        let found: Vec<Cell> = leaves(&octree).into_iter().filter(inside).collect();
        prop_assert_eq!(found, vec![octree.locate(u).leaf]);
    }

    #[test]
    fn interpolation_reproduces_linear_functions((octree, u) in octrees_and_points()) {
        // Hanging corners are means of the ends of their edge or face, so linear functions pass through unharmed.
        let linear = |p: DVec3| 1.0 + 2.0 * p.x - 3.0 * p.y + 0.5 * p.z;
        let values: Vec<f64> = octree.vertex_positions().map(|p| linear(DVec3::from(p.map(f64::from)))).collect();
        // Values reach 100 and pass through a few dozen rounded operations.
        prop_assert!((interpolate(&octree, &values, u) - linear(u)).abs() < 1e-11);
    }

    #[test]
    fn interpolation_is_continuous_across_every_contact((octree, u) in octrees_and_points()) {
        let values = values(&octree);
        let here = interpolate(&octree, &values, u);
        let m = f64::from(1_u32 << octree.finest());
        let step = 1e-9;
        for side in 0..27 {
            let steps = DVec3::new(f64::from(side % 3 - 1), f64::from(side / 3 % 3 - 1), f64::from(side / 9 - 1));
            let near = (u + step * steps).clamp(DVec3::ZERO, DVec3::splat(m));
            // Values lie in [0, 1) and cells have edge >= 1, so the slope is below 1 per axis, 3 in all.
            let jump = (interpolate(&octree, &values, near) - here).abs();
            prop_assert!(jump <= 3.0 * step + 1e-13, "jump {} at {} towards {}", jump, u, steps);
        }
    }

    #[test]
    fn stored_masks_give_the_same_octree(octree in octrees()) {
        let (root_split, masks) = octree.cells().raw();
        prop_assert_eq!(Octree::from_raw(octree.finest(), root_split, &masks), Ok(octree.clone()));
    }

    #[test]
    fn arbitrary_masks_never_panic(
        finest in 1_u8..=4,
        root_split: bool,
        masks in proptest::collection::vec(any::<u8>(), 0..40),
    ) {
        if let Ok(octree) = Octree::from_raw(finest, root_split, &masks) {
            prop_assert!(octree.validate().is_ok());
        }
    }
}

#[test]
fn balance_adds_nothing_that_is_not_needed() {
    // One finest cell in a corner gives the classic graded chain: one split cell per level.
    let octree = Octree::refined(5, [Cell { level: 5, index: [0; 3] }]);
    let stats = octree.validate().unwrap();
    assert_eq!(stats.leaves_per_level, [0, 7, 7, 7, 7, 8]);
    // Without wanted cells, the octree is the box itself.
    assert_eq!(Octree::refined(5, []).validate().unwrap().leaves_per_level, [1, 0, 0, 0, 0, 0]);
}

#[test]
fn fully_refined_has_all_lattice_points() {
    let all = (0..512_u64).map(|code| Cell { level: 3, index: morton::decode(code) });
    let stats = Octree::refined(3, all).validate().unwrap();
    assert_eq!((stats.free_vertices, stats.hanging_corners), (729, 0));
}

#[test]
fn unbalanced_masks_are_refused() {
    // Child 7 of the root is split, then twice its child 0: leaves of level 4 touch leaf 0 of level 1.
    let refusal = Octree::from_raw(4, true, &[1 << 7, 1, 1]).unwrap_err();
    assert!(refusal.contains("2:1"), "{refusal}");
}
