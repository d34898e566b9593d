//! Whatever is merged in whatever order, nested or at once: nothing is lost and nothing is counted twice. Sums are
//! small integers here, which f64 adds exactly, so that a plain sum over all parts is the result bit for bit.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::Path;

use proptest::prelude::*;
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;
use rand::{Rng, RngExt, SeedableRng};

use super::*;
use crate::geometry::{Aabb, Lattice};
use crate::posterior::{
    Covariance, DataScale, DensePosterior, OctreePosterior, Posterior, RayCoverage, Scale, VertexSums,
    negligible_information,
};
use crate::rays::Shard;
use crate::uncertainty::layers::Layers;
use crate::uncertainty::tests::{barred, on_own_octree};
use crate::uncertainty::{RunRecord, StandardDeviations, Support};

const LEVEL: u8 = 4;

/// What one part has.
struct Made {
    field: UncertaintyField,
    sums: BTreeMap<[u32; 3], VertexSums>,
}

fn lattice() -> Lattice {
    Lattice::new(Aabb::centered_cube(1.0), LEVEL).unwrap()
}

/// A part of a run with arbitrary sums; the points of all parts are few, so that they have many in common.
fn part(seed: u64, shard: Shard, is_dense: bool, random: &mut impl Rng) -> Made {
    let lattice = lattice();
    let data = DataScale::new(1000, 0.02, 0.05).unwrap();
    let rays = shard.own_rays();
    let record = RunRecord {
        dropped: random.random_range(1..30),
        seed: Some(seed),
        shard: Some(shard),
        scale: Scale::Data(data),
        lambda: data.lambda(),
        // Nothing that a ray touched is negligible.
        tolerance: 0.0,
        ..crate::uncertainty::tests::record(&lattice, Covariance::Block, rays)
    };
    let mut sums = BTreeMap::new();
    for _ in 0..200 {
        let point = [0; 3].map(|_| 5 * random.random_range(0..=3) + random.random_range(0..=1));
        let [a, b, c] = [0; 3].map(|_| f64::from(random.random_range(1..20)));
        let own = VertexSums::new([a * a, a * b, a * c, b * b, b * c, c * c], random.random_range(1..9));
        sums.insert(point, own);
    }
    let field = if is_dense {
        let mut all = DensePosterior::new(lattice).into_sums();
        sums.iter().for_each(|(point, own)| all[lattice.dense_index(*point)] = *own);
        UncertaintyField::new(record, lattice, Support::Dense, all)
    } else {
        let mut posterior = OctreePosterior::new(lattice);
        sums.iter().for_each(|(point, own)| posterior.add_sums(*point, own));
        on_own_octree(record, lattice, posterior)
    };
    let surface = (0..random.random_range(0..6)).map(|_| [random.random_range(-1.0..1.0); 3]).collect();
    let cells = 1 << (3 * LEVEL);
    let counts = (0..cells).map(|_| random.random_range(0..1000)).collect();
    let ray_coverage = RayCoverage::from_counts(&lattice, counts);
    Made { field: field.with_surface(surface).with_ray_coverage(ray_coverage), sums }
}

/// Merges some of the parts, then the results, and so on.
fn nested(mut fields: Vec<UncertaintyField>, random: &mut impl Rng) -> UncertaintyField {
    while fields.len() > 1 {
        fields.shuffle(random);
        let together = random.random_range(2..=fields.len().min(4));
        let some = fields.split_off(fields.len() - together);
        fields.push(merge(&some).unwrap());
    }
    fields.pop().unwrap()
}

/// Adds what parts have, point by point.
fn added<'a>(parts: impl IntoIterator<Item = &'a Made>) -> BTreeMap<[u32; 3], VertexSums> {
    let mut all = BTreeMap::<[u32; 3], VertexSums>::new();
    for (point, own) in parts.into_iter().flat_map(|part| &part.sums) {
        let sum = all.entry(*point).or_default();
        sum.information.iter_mut().zip(own.information).for_each(|(sum, more)| *sum += more);
        sum.rays += own.rays;
    }
    all
}

/// Counts of ray coverage, added cell by cell.
fn coverage_of(parts: &[Made]) -> Vec<u32> {
    let each = parts.iter().map(|part| part.field.ray_coverage().unwrap().counts());
    each.fold(vec![0; 1 << (3 * LEVEL)], |sum, more| sum.iter().zip(more).map(|(a, b)| a + b).collect())
}

/// Sums of a field at the points where it has any.
fn sums_of(field: &UncertaintyField) -> BTreeMap<[u32; 3], VertexSums> {
    let positions: Vec<[u32; 3]> = match field.support() {
        Support::Dense => (0..field.sums().unwrap().len()).map(|v| field.lattice().dense_point(v)).collect(),
        Support::Octree(octree) => octree.vertex_positions().collect(),
    };
    let all = positions.into_iter().zip(field.sums().unwrap().iter().copied());
    all.filter(|(_, sums)| sums.rays > 0).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn any_order_and_nesting_of_seeds_and_shards_gives_all_that_they_have(
        choice: u64,
        seeds in 1_u64..4,
        of in 1_u64..4,
        is_dense: bool,
        without_coverage in prop_oneof![3 => Just(None), 1 => (0_usize..9).prop_map(Some)],
    ) {
        let random = &mut ChaCha8Rng::seed_from_u64(choice);
        let parts = seeds * of;
        prop_assume!(parts > 1);
        let all_rays = 512 * 6 * of;
        let ray_sets = (0..seeds).flat_map(|seed| (0..of).map(move |index| (seed, Shard::new(all_rays, index, of))));
        let mut parts: Vec<Made> = ray_sets.map(|(seed, shard)| part(seed, shard, is_dense, random)).collect();
        let expected_coverage = coverage_of(&parts);
        let n = parts.len();
        if let Some(i) = without_coverage {
            parts[i % n].field.layers.ray_coverage = None;
        }
        let fields = || parts.iter().map(|part| part.field.clone()).collect::<Vec<_>>();
        let most = parts.iter().map(|part| part.field.surface().len()).max();
        let of_first = parts.iter().flat_map(|part| part.field.surface().to_vec());
        let flat = merge(&fields()).unwrap();
        let surface: Vec<[f32; 3]> = of_first.take(most.unwrap()).collect();
        prop_assert_eq!(flat.surface(), &surface[..], "of the parts in order, as many as the part with the most has");
        for (name, merged) in [("at once", flat), ("nested", nested(fields(), random))] {
            prop_assert_eq!(sums_of(&merged), added(&parts), "{}", name);
            let RunRecord { rays, dropped, seed, shard, .. } = merged.record().clone();
            prop_assert_eq!(rays, seeds * all_rays, "{}", name);
            let each = parts.iter().map(|part| part.field.record().dropped);
            prop_assert_eq!(dropped, each.sum::<u64>(), "{}", name);
            let one = (seeds == 1).then_some(0);
            prop_assert_eq!((seed, shard), (one, one.map(|_| Shard::whole(all_rays))), "{}", name);
            let whole = |seed| RaySet { seed, shard: Shard::whole(all_rays) };
            prop_assert_eq!(merged.ray_sets(), &(0..seeds).map(whole).collect::<Vec<_>>()[..], "{}", name);
            prop_assert!(!merged.is_part(), "{}", name);
            let counts = merged.ray_coverage().map(|ray_coverage| ray_coverage.counts().to_vec());
            prop_assert_eq!(counts, without_coverage.is_none().then(|| expected_coverage.clone()), "{}", name);
            prop_assert_eq!(merged.surface().len(), most.unwrap(), "{}", name);
            // U is that of the sums, whatever U of the parts was.
            let record = merged.record().clone();
            let sums = merged.sums().unwrap().to_vec();
            let anew = UncertaintyField::new(record, lattice(), merged.support().clone(), sums);
            prop_assert_eq!(anew.deviations(), merged.deviations(), "{}", name);
            prop_assert_eq!(anew.rays(), merged.rays(), "{}", name);
        }
    }
}

/// What was left out of the octree of a run was negligible for its rays: no more may be left out for those of all.
#[test]
fn what_counts_in_the_shorter_run_counts_in_both() {
    let lattice = lattice();
    let run = |seed: u64, rays: u64, point: [u32; 3], times: f64| {
        let record = RunRecord {
            seed: Some(seed),
            shard: Some(Shard::whole(rays)),
            ..crate::uncertainty::tests::record(&lattice, Covariance::Block, rays)
        };
        let entry = times * negligible_information(record.tolerance, rays, record.lambda) / 3.0;
        let mut posterior = OctreePosterior::new(lattice);
        posterior.add_sums(point, &VertexSums::new([entry, 0.0, 0.0, entry, 0.0, entry], 3));
        on_own_octree(record, lattice, posterior)
    };
    let (short, long) = (run(0, 1024, [5, 6, 7], 3.0), run(1, 102_400, [12, 3, 9], 3.0));
    for parts in [[short.clone(), long.clone()], [long, short]] {
        let merged = merge(&parts).unwrap();
        let Support::Octree(octree) = merged.support() else { panic!("an octree") };
        assert!([[5, 6, 7], [12, 3, 9]].iter().all(|point| octree.vertex(*point).is_some()));
        assert!(octree.vertex_count() < 1000);
    }
}

/// If the rays of one part are unknown, so are those of all.
#[test]
fn one_part_of_unknown_rays_makes_all_unknown() {
    let random = &mut ChaCha8Rng::seed_from_u64(5);
    for unknown in 0..3 {
        let mut fields: Vec<UncertaintyField> =
            (0..3).map(|seed| part(seed, Shard::whole(3072), false, random).field).collect();
        for (i, field) in fields.iter_mut().enumerate() {
            // As if other programs had drawn the rays: only then do sources distinguish parts.
            (field.record.march_step, field.record.source) = (None, i.to_string());
        }
        fields[unknown].layers.ray_sets = None;
        assert_eq!(merge(&fields).unwrap().ray_sets(), []);
    }
}

fn refusal(joined: Result<UncertaintyField>) -> String {
    let Err(error) = joined else { panic!("a refusal") };
    error.to_string()
}

/// Whatever the room for sums, of files as of fields. Those of shards are exact, so that all bits are the same.
#[test]
fn sums_that_leave_memory_join_to_the_same_field() {
    let random = &mut ChaCha8Rng::seed_from_u64(8);
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let written = |name: &str, fields: &[UncertaintyField]| -> Vec<PathBuf> {
        let path = |i: usize| folder.path().join(format!("{name}{i}.oct"));
        fields.iter().enumerate().for_each(|(i, field)| field.write(&path(i)).unwrap());
        (0..fields.len()).map(path).collect()
    };
    let mut made = |seed: u64, shard| part(seed, shard, false, random).field;
    let shards: Vec<UncertaintyField> = (0..5).map(|index| made(1, Shard { rays: 512 * 25, index, of: 6 })).collect();
    let seeds: Vec<UncertaintyField> = (0..5).map(|seed| made(seed, Shard::whole(512 * (seed + 2)))).collect();
    let of_shards = written("shard", &shards);
    let files = written("seed", &seeds);
    // Factors in files round, of whole runs.
    let seeds: Vec<UncertaintyField> = files.iter().map(|file| UncertaintyField::read(file).unwrap()).collect();
    let memory = {
        let mut posterior = OctreePosterior::new(lattice());
        (0..16).for_each(|i| posterior.add_sums([i; 3], &VertexSums::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 1)));
        posterior.memory()
    };
    for room in [1, memory, 3 * memory, usize::MAX] {
        let with = |keep_sums: bool, error_bars: bool| {
            let settings = Merging::default().keep_sums(keep_sums).error_bars(error_bars).scratch(scratch.path());
            Merging { room, ..settings }
        };
        assert!(with(true, false).join(&of_shards).unwrap() == merge(&shards).unwrap(), "{room} bytes");
        for [keep_sums, error_bars] in [[false, false], [true, true], [false, true]] {
            let free = Merging { room: usize::MAX, ..with(keep_sums, error_bars) }.join(&seeds).unwrap();
            assert_eq!((free.sums().is_some(), free.error_bars().is_some()), (keep_sums, error_bars));
            let bound = with(keep_sums, error_bars).join(&files).unwrap();
            assert!(bound.support() == free.support() && bound.rays() == free.rays());
            // Of sums that differ by n ε, a step of f32 at most.
            let close = |a: f64, b: f64| (a - b).abs() <= f64::from(f32::EPSILON) * b;
            assert!(bound.deviations().iter().zip(free.deviations().iter()).all(|(a, b)| close(a, b)));
            for (a, b) in bound.error_bars().iter().zip(&free.error_bars()) {
                let known = (0..a.len()).filter(|&v| a.get(v).is_some()).count();
                assert!(known > 50 && (0..a.len()).all(|v| a.get(v).is_some() == b.get(v).is_some()), "{known}");
                let off = |v: usize| a.get(v).zip(b.get(v)).map_or(0.0, |(a, b)| (a - b).abs() - b * 2.0_f64.powi(-10));
                assert!((0..a.len()).all(|v| off(v) < 3e-7));
            }
        }
    }
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0, "no file has a name");
    // A folder in which nothing can be written is named; without need of it, it is not looked at.
    let nowhere = Merging::default().scratch(folder.path().join("none"));
    assert!(nowhere.join(&files).is_ok());
    let error = refusal(Merging { room: 1, ..nowhere }.join(&files));
    assert!(error.contains("none"), "{error}");
}

/// Files with valid checksums whose sections do not fit together.
#[test]
fn forged_parts_are_refused() {
    let random = &mut ChaCha8Rng::seed_from_u64(9);
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    for is_dense in [false, true] {
        let of = |seed: u64, random: &mut ChaCha8Rng| part(seed, Shard::whole(512 * 9), is_dense, random).field;
        let (whole, mut more, mut fewer, mut none) = (of(1, random), of(2, random), of(3, random), of(4, random));
        more.layers.sums.as_mut().unwrap().push(VertexSums::default());
        fewer.layers.sums.as_mut().unwrap().pop();
        none.layers.sums = None;
        let mut deviations = of(5, random);
        deviations.deviations = StandardDeviations::from(vec![0.01_f32; 3]);
        whole.write(&file("whole.oct")).unwrap();
        for (forged, expected) in [(more, "sums"), (fewer, "sums"), (none, "kept sums"), (deviations, "deviations")] {
            forged.write(&file("forged.oct")).unwrap();
            let error = refusal(merge(&[file("whole.oct"), file("forged.oct")]));
            assert!(error.contains(expected) && error.contains("forged.oct"), "{error}");
        }
    }
    let many: Vec<UncertaintyField> = (0..65).map(|seed| part(seed, Shard::whole(512), false, random).field).collect();
    let error = refusal(Merging::default().error_bars(true).join(&many));
    assert!(error.contains("at most 64 fields"), "{error}");
}

/// A file that another replaces after it was opened so many times.
struct Replaced<'a> {
    file: PathBuf,
    by: &'a Path,
    after: u32,
    opened: Cell<u32>,
}

impl Replaced<'_> {
    fn opens(&self) {
        self.opened.update(|opened| opened + 1);
        if self.opened.get() > self.after {
            std::fs::copy(self.by, &self.file).unwrap();
        }
    }
}

impl Part for Replaced<'_> {
    fn head(&self, number: usize) -> Result<Head> {
        self.opens();
        self.file.head(number)
    }

    fn without_sums(&self, head: &Head) -> Result<(Cow<'_, Support>, Cow<'_, Layers>)> {
        self.opens();
        self.file.without_sums(head)
    }

    fn each_sums(&self, head: &Head, vertices: u64, visit: &mut dyn FnMut(VertexSums) -> Result<()>) -> Result<()> {
        self.opens();
        self.file.each_sums(head, vertices, visit)
    }
}

#[test]
fn a_file_that_is_replaced_while_it_is_joined_is_refused() {
    let random = &mut ChaCha8Rng::seed_from_u64(10);
    let folder = tempfile::tempdir().unwrap();
    let [own, other, more] = ["own.oct", "other.oct", "more.oct"].map(|name| folder.path().join(name));
    let fields = [1, 2, 3, 4, 5].map(|seed| {
        let mut field = part(seed, Shard::whole(512 * 9), false, random).field;
        field.record.dropped = 0;
        field
    });
    fields[4].write(&more).unwrap();
    // Two merged fields may have the same record; they differ by the rays that they count.
    let merged = [[0, 1], [2, 3]].map(|pair| merge(&pair.map(|i| &fields[i])).unwrap());
    assert_eq!(merged[0].record(), merged[1].record());
    for [of_own, of_other] in [[&fields[0], &fields[1]], [&merged[0], &merged[1]]] {
        of_other.write(&other).unwrap();
        for after in 1..=3 {
            of_own.write(&own).unwrap();
            let replaced = Replaced { file: own.clone(), by: &other, after, opened: Cell::new(0) };
            let kept = Replaced { file: more.clone(), by: &more, after: u32::MAX, opened: Cell::new(0) };
            let joined = merge(&[replaced, kept]);
            if after == 3 {
                assert_eq!(joined.unwrap(), merge(&[own.clone(), more.clone()]).unwrap());
            } else {
                let error = refusal(joined);
                assert!(error.contains("own.oct") && error.contains("replaced"), "{error}");
            }
        }
    }
}

/// Error bars compare parts with what each of them has, in whatever order they are given.
#[test]
fn error_bars_of_merged_parts_do_not_depend_on_their_order() {
    let random = &mut ChaCha8Rng::seed_from_u64(3);
    // Runs of different lengths: if rays and sums of different parts were paired, bars would be others.
    let lengths = [512 * 6, 512 * 9, 512 * 30];
    let parts: Vec<Made> = (0..3).map(|i| part(7 - i, Shard::whole(lengths[i as usize]), true, random)).collect();
    let fields: Vec<UncertaintyField> = parts.iter().map(|part| part.field.clone()).collect();
    let merged = Merging::default().error_bars(true).join(&fields).unwrap();
    let groups = [0, 1, 2].map(|i| fields[i].sums().unwrap().to_vec());
    let expected = barred(merge(&fields).unwrap(), groups, &lengths);
    let bars = |field: &UncertaintyField| {
        let bars = field.error_bars().unwrap();
        (0..bars.len()).map(|v| bars.get(v)).collect::<Vec<_>>()
    };
    assert!(bars(&merged).iter().flatten().count() > 50);
    assert_eq!(bars(&merged), bars(&expected));
}
