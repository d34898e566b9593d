//! Rankings on scenes so small that everything can be found otherwise.

mod splats;

use glam::{DMat3, DVec3};

use super::evidence::{Evidence, Viewer};
use super::*;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::{Camera, Domain, Lattice};
use octobayes::monitor::{Monitor, Silent};
use octobayes::octree::{MaxLevels, morton};
use octobayes::posterior::{
    Covariance, Criteria, DataScale, Information, OctreePosterior, Pooling, Posterior, Reading, Refinement, Scale,
    comparable,
};
use octobayes::render::RaySamples;
use octobayes::render::{Outputs, Renderer, VolumeRenderer};
use octobayes::uncertainty::{RunRecord, UncertaintyField};
use octobayes::{Error, Result};

const SIDE: u32 = 16;
const PIXELS: u64 = (SIDE * SIDE) as u64;
const NOISE: f64 = 0.05;

fn scene() -> ClosedForm {
    ClosedForm::courtyard()
}

/// Eight cameras on a circle, at two heights.
fn circle() -> Vec<Camera> {
    let camera = |k: u32| {
        let angle = std::f64::consts::TAU * f64::from(k) / 8.0;
        let eye = DVec3::new(2.8 * angle.cos(), 2.8 * angle.sin(), if k.is_multiple_of(2) { 0.9 } else { 1.7 });
        Camera::look_at(eye, DVec3::new(0.0, 0.0, -0.25), DVec3::Z, 0.8, [SIDE, SIDE])
    };
    (0..8).map(camera).collect()
}

fn lattice() -> Lattice {
    Lattice::from_domain(Domain::Box(scene().bounds()), 6).unwrap()
}

/// Leaves of which some are coarser, so that corners hang.
fn uneven() -> MaxLevels {
    MaxLevels::balanced(6, [(0, 6), (3, 5), (5, 6), (6, 4)])
}

fn source(scene: &ClosedForm) -> VolumeRenderer<'_> {
    RaySettings::default().occupancy(32).volume(scene, &lattice(), &Silent).unwrap()
}

fn viewer(source: &dyn Renderer) -> Viewer<'_> {
    let cells = lattice().coarsened(3);
    Viewer {
        source,
        pixel_offset: 0.5,
        precision: None,
        ray_coverage: None,
        cells,
        region: None,
        pixels: PIXELS,
        seed: 0,
    }
}

/// The samples of every pixel draw of some views.
fn samples(cameras: &[Camera]) -> Vec<RaySamples> {
    let scene = scene();
    let source = source(&scene);
    let viewer = viewer(&source);
    let samples = |camera| {
        evidence::samples(&*source.view(camera, Outputs::Derivatives), &viewer.points(camera), &Silent).unwrap()
    };
    cameras.iter().flat_map(samples).collect()
}

/// The field of one ray for each pixel of `views` views, whose samples are these.
fn field(samples: &[RaySamples], views: u64, limits: &MaxLevels) -> UncertaintyField {
    field_on(lattice(), samples, views, limits)
}

fn field_on(lattice: Lattice, samples: &[RaySamples], views: u64, limits: &MaxLevels) -> UncertaintyField {
    field_by(Pooling::Off, lattice, samples, views, limits)
}

fn field_by(
    pooling: Pooling,
    lattice: Lattice,
    samples: &[RaySamples],
    views: u64,
    limits: &MaxLevels,
) -> UncertaintyField {
    let data = DataScale::new(views * PIXELS, NOISE, 0.05).unwrap();
    let mut record = RunRecord::unstated("test".into(), views * PIXELS, data.lambda(), Covariance::Block);
    (record.scale, record.pooling) = (Scale::Data(data), pooling);
    let mut posterior = OctreePosterior::limited(lattice, limits.clone());
    posterior.add(samples);
    let everything = Refinement::above(Refinement::EVERYTHING, &record.reading(), Criteria::default(), Vec::new());
    let octree = posterior.octree(&everything).unwrap();
    UncertaintyField::on_octree(record, lattice, posterior, octree, true).unwrap()
}

fn settings() -> Settings {
    Settings::default().pixels(PIXELS).occupancy(32)
}

fn same(a: &Ranking, b: &Ranking) -> bool {
    let steps = |ranking: &Ranking| -> Vec<(usize, u64, u64, Option<u64>)> {
        let bits =
            |step: &Step| (step.index, step.gain.to_bits(), step.surface.to_bits(), step.unseen.map(f64::to_bits));
        ranking.steps.iter().map(bits).collect()
    };
    let bits = |ranking: &Ranking| ranking.gains.iter().map(|gain| gain.to_bits()).collect::<Vec<_>>();
    steps(a) == steps(b) && bits(a) == bits(b) && a.blanks == b.blanks && a.complete == b.complete
}

fn matrix([xx, xy, xz, yy, yz, zz]: Information) -> DMat3 {
    DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
}

/// What the views add, added up, and P before, vertex by vertex.
fn totals(field: &UncertaintyField, evidence: &[Evidence]) -> Vec<(DMat3, DMat3)> {
    let precision = field.precision().unwrap();
    let mut all = std::collections::BTreeMap::new();
    for added in evidence.iter().flat_map(|evidence| &evidence.added) {
        let entry = all.entry(added.code).or_insert_with(|| (matrix(precision.before(added)), DMat3::ZERO));
        entry.1 += matrix(added.precision);
    }
    all.into_values().collect()
}

fn evidence(field: &UncertaintyField, cameras: &[Camera]) -> Vec<Evidence> {
    let (scene, precision) = (scene(), field.precision().unwrap());
    let source = source(&scene);
    let viewer = Viewer { precision: Some(&precision), ..viewer(&source) };
    cameras.iter().map(|camera| viewer.evidence(camera, &Silent).unwrap()).collect()
}

/// Σ_v ½ log (det (P + ΔP) / det P), which is another way to it.
fn worth(field: &UncertaintyField, evidence: &[Evidence]) -> f64 {
    let gain = |(p, delta): &(DMat3, DMat3)| 0.5 * ((*p + *delta).determinant() / p.determinant()).ln();
    totals(field, evidence).iter().map(gain).sum()
}

#[test]
fn the_predicted_deviations_are_those_found_once_the_rays_are_added() {
    let cameras = circle();
    let (training, candidate) = (samples(&cameras[..3]), samples(&cameras[5..6]));
    for limits in [MaxLevels::none(6), uneven()] {
        let before = field(&training, 3, &limits);
        // One ray a pixel, as before: N / R stays.
        let after = field(&[training.clone(), candidate.clone()].concat(), 4, &limits);
        let precision = before.precision().unwrap();
        let found = evidence(&before, &cameras[5..6]);
        let Scale::Data(data) = after.record().scale else { panic!("{:?}", after.record().scale) };
        let reading: Reading = after.record().reading();
        let mut later = OctreePosterior::limited(lattice(), limits.clone());
        later.add(&training);
        later.add(&candidate);
        let (mut changed, mut coarse) = (0, 0);
        for added in &found[0].added {
            let point = morton::decode(added.code);
            let sums = comparable(&limits, point, later.sums(point));
            let predicted: Information = std::array::from_fn(|k| precision.before(added)[k] + added.precision[k]);
            let real = data.precision(&sums.information, 4 * PIXELS);
            let scale = real[0] + real[3] + real[5];
            for (a, b) in predicted.iter().zip(real) {
                assert!((a - b).abs() <= 1e-12 * scale, "{point:?}: {predicted:?}, {real:?}");
            }
            // And so is σ, as the field with these rays stores it.
            let inverse = matrix(predicted).inverse();
            let sigma = (0..3).map(|k| inverse.col(k)[k]).sum::<f64>().sqrt();
            let stored = f64::from(reading.deviation_at(&limits, point, later.sums(point)));
            assert!((sigma / stored - 1.0).abs() < 1e-6, "{point:?}: {sigma}, {stored}");
            let old = data.precision(&[0.0; 6], 1)[0];
            changed += usize::from(added.precision[0] + added.precision[3] > 0.1 * old);
            coarse += usize::from(octobayes::octree::coarseness(&limits, point) > 0);
        }
        assert!(changed > 100, "{changed} vertices with more than the prior's information");
        assert_eq!(coarse > 50, !limits.is_unlimited(), "{coarse} vertices of coarser leaves");
        // The whole of the change is predicted: no other vertex has other sums.
        let touched = found[0].added.len();
        let differ = {
            use rayon::prelude::*;
            let mut earlier = OctreePosterior::limited(lattice(), limits.clone());
            earlier.add(&training);
            later.touched().filter(|(point, sums)| earlier.sums(*point).information != sums.information).count()
        };
        assert!(differ <= touched && differ > touched / 2, "{differ} of {touched}");
    }
}

/// Pooled sums are not those of a vertex's own rays, to which the rays of a view are added.
#[test]
fn views_of_a_pooled_field_are_worth_what_they_are_without_pooling() {
    let (circle, limits) = (circle(), MaxLevels::none(lattice().level()));
    let samples = samples(&circle[..2]);
    let fields = [Pooling::Off, Pooling::Auto].map(|by| field_by(by, lattice(), &samples, 2, &limits));
    assert!(fields[0].deviations() != fields[1].deviations());
    let [plain, pooled] = fields.each_ref().map(|field| worth(field, &evidence(field, &circle[2..4])));
    assert!(plain > 0.0 && (plain / pooled - 1.0).abs() < 1e-12, "{plain} and {pooled}");
}

#[test]
fn greedy_views_are_worth_what_they_are_together_and_nearly_the_best_pair() {
    let cameras = circle();
    let (training, candidates) = (field(&samples(&cameras[..1]), 1, &MaxLevels::none(6)), &cameras[1..]);
    let ranking = NextView::new(&scene(), &training, candidates).settings(settings().take(5)).run().unwrap();
    let all = evidence(&training, candidates);
    let single: Vec<f64> = all.iter().map(|one| worth(&training, std::slice::from_ref(one))).collect();
    for (by_definition, found) in single.iter().zip(&ranking.gains) {
        // Thousands of vertices whose P has a condition of up to 1e8.
        assert!((by_definition / found - 1.0).abs() < 1e-7, "{by_definition} {found}");
    }
    let best = (0..single.len()).max_by(|a, b| single[*a].total_cmp(&single[*b])).unwrap();
    assert_eq!(ranking.steps[0].index, best);
    // What is taken later counts beside what was taken before.
    let mut taken = Vec::new();
    let mut sum = 0.0;
    for step in &ranking.steps {
        taken.push(all[step.index].clone());
        sum += step.gain;
        let together = worth(&training, &taken);
        assert!((sum / together - 1.0).abs() < 1e-7, "{sum} {together}");
        assert!((step.gain_per_pixel * PIXELS as f64 / step.gain - 1.0).abs() < 1e-12);
    }
    let last = ranking.steps[4];
    // Pixels are wider than cells here, so that views share few vertices; the tolerance above is a thousandth of this.
    assert!(last.gain < (1.0 - 1e-4) * ranking.gains[last.index], "{last:?} of {}", ranking.gains[last.index]);
    let pairs = (0..all.len()).flat_map(|i| (0..i).map(move |j| [i, j]));
    let best_pair = pairs.map(|pair| worth(&training, &pair.map(|k| all[k].clone()))).fold(0.0, f64::max);
    let greedy = ranking.steps[0].gain + ranking.steps[1].gain;
    assert!(greedy <= best_pair * (1.0 + 1e-7) && greedy > 0.97 * best_pair, "{greedy} of {best_pair}");
}

#[test]
fn lazy_rescoring_takes_the_same_views_with_less_work() {
    let cameras = circle();
    let (training, candidates) = (field(&samples(&cameras[..1]), 1, &uneven()), &cameras[1..]);
    for gain in [Gain::Logdet, Gain::Trace, Gain::Coverage] {
        let ranked = |rescoring, memory| {
            let settings = settings().take(5).gain(gain).rescoring(rescoring).memory(memory);
            NextView::new(&scene(), &training, candidates).training(&cameras[..1]).settings(settings).run().unwrap()
        };
        let [lazy, full, traced_again] =
            [(Rescoring::Lazy, 1 << 30), (Rescoring::All, 1 << 30), (Rescoring::Lazy, 0)].map(|(r, m)| ranked(r, m));
        assert_eq!(lazy.steps.len(), 5, "{gain:?}");
        assert!(same(&lazy, &full) && same(&lazy, &traced_again), "{gain:?}: {lazy:?}, {full:?}");
        // Six, five, four and three are left after each of the first four steps.
        assert_eq!(full.rescored, 6 + 5 + 4 + 3, "{gain:?}");
        assert!(lazy.rescored < full.rescored, "{gain:?}: {} of {}", lazy.rescored, full.rescored);
        assert!(lazy.steps.windows(2).all(|pair| pair[1].gain <= pair[0].gain), "{gain:?}");
    }
}

#[test]
fn the_trace_is_the_log_det_of_little_and_no_less_of_much() {
    let cameras = circle();
    let training = field(&samples(&cameras[..3]), 3, &MaxLevels::none(6));
    let found = evidence(&training, &cameras[4..5]);
    let precision = training.precision().unwrap();
    let sum = |of: fn(&Information, &Information) -> f64, share: f64| -> f64 {
        let each = found[0].added.iter();
        each.map(|added| of(&precision.before(added), &added.precision.map(|p| share * p))).sum()
    };
    let ratio = |share: f64| sum(log_det, share) / sum(first_order, share);
    assert!(ratio(1.0) < 0.5, "{}", ratio(1.0));
    assert!((1.0 - 1e-3..=1.0).contains(&ratio(1e-9)), "{}", ratio(1e-9));
}

/// A gain of one's own: the log det itself ranks as before, and that of vertices that no ray reached is a part of it.
#[test]
fn a_gain_of_ones_own_stands_for_that_of_a_vertex() {
    let cameras = circle();
    let training = field(&samples(&cameras[..2]), 2, &MaxLevels::none(6));
    let Scale::Data(data) = training.record().scale else { panic!("the scale of the data") };
    let scene = scene();
    let next = || NextView::new(&scene, &training, &cameras[2..]).settings(settings().take(3));
    let built_in = next().run().unwrap();
    assert!(same(&built_in, &next().vertex_gain(&log_det).run().unwrap()));
    let prior = data.precision(&[0.0; 6], 1);
    let of_unseen = |p: &Information, added: &Information| if *p == prior { log_det(p, added) } else { 0.0 };
    let unseen = next().vertex_gain(&of_unseen).run().unwrap();
    let coverage = next().training(&cameras[..2]).settings(settings().gain(Gain::Coverage)).vertex_gain(&of_unseen);
    assert!(coverage.run().unwrap_err().to_string().contains("coverage"), "a gain without an effect is refused");
    let found = evidence(&training, &cameras[2..]);
    let precision = training.precision().unwrap();
    for ((part, whole), evidence) in unseen.gains.iter().zip(&built_in.gains).zip(&found) {
        assert!(0.0 < *part && part < whole, "{part} of {whole}");
        let new = evidence.added.iter().filter(|added| precision.before(added) == prior);
        let expected: f64 = new.map(|added| log_det(&prior, &added.precision)).sum();
        assert!((part / expected - 1.0).abs() < 1e-12, "{part}, {expected}");
    }
}

#[test]
fn too_few_rays_for_the_vertices_are_told() {
    let cameras = circle();
    let ranked = |level: u8, pixels: u64| {
        let lattice = Lattice::from_domain(Domain::Box(scene().bounds()), level).unwrap();
        let training = field_on(lattice, &samples(&cameras[..1]), 1, &MaxLevels::none(level));
        NextView::new(&scene(), &training, &cameras[1..]).settings(settings().pixels(pixels)).run().unwrap()
    };
    // Eight rays hardly ever meet the same vertices.
    let few = ranked(6, 8).rays_per_vertex.unwrap();
    assert!((1.0..1.2).contains(&few), "{few}");
    // 16 x 16 rays over the scene: a sixteenth of it apart, beside cells of an eighth and of a 64th.
    let [coarse, fine] = [3, 6].map(|level| ranked(level, PIXELS));
    assert!(coarse.rays_per_vertex > Some(4.0) && coarse.doubt().is_none(), "{:?}", coarse.rays_per_vertex);
    assert!(fine.rays_per_vertex < Some(2.0), "{:?}", fine.rays_per_vertex);
    assert!(fine.doubt().unwrap().contains("--pixels"));
    let coverage = NextView::new(&scene(), &field(&samples(&cameras[..1]), 1, &MaxLevels::none(6)), &cameras[1..])
        .training(&cameras[..1])
        .settings(settings().gain(Gain::Coverage))
        .run()
        .unwrap();
    assert_eq!((coverage.rays_per_vertex, coverage.doubt()), (None, None));
}

#[test]
fn threads_do_not_count() {
    let cameras = circle();
    let training = field(&samples(&cameras[..2]), 2, &uneven());
    let ranked = |threads: usize, gain: Gain| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let settings = settings().take(4).gain(gain);
        let scene = scene();
        let next = NextView::new(&scene, &training, &cameras[2..]).training(&cameras[..2]).settings(settings);
        pool.install(|| next.run()).unwrap()
    };
    for gain in [Gain::Logdet, Gain::Trace, Gain::Coverage] {
        let [one, three] = [1, 3].map(|threads| ranked(threads, gain));
        assert!(same(&one, &three), "{gain:?}");
    }
}

#[test]
fn rays_stand_for_all_pixels_of_their_view() {
    let cameras = circle();
    let field = field(&samples(&cameras[..2]), 2, &MaxLevels::none(6));
    let (scene, precision) = (scene(), field.precision().unwrap());
    let source = source(&scene);
    let eye = DVec3::new(-2.8, 0.0, 0.9);
    let camera = Camera::look_at(eye, DVec3::new(0.0, 0.0, -0.25), DVec3::Z, 0.8, [96, 96]);
    let total = |pixels: u64| -> f64 {
        let viewer = Viewer { precision: Some(&precision), pixels, ..viewer(&source) };
        let found = viewer.evidence(&camera, &Silent).unwrap();
        found.added.iter().map(|added| [0, 3, 5].map(|k| added.precision[k]).iter().sum::<f64>()).sum()
    };
    // If squares of J spread five times as widely as their mean, 2,304 rays leave a tenth open: two deviations. Without
    // a weight of 4, the ratio would be a quarter.
    let ratio = total(96 * 96 / 4) / total(96 * 96);
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}

#[test]
fn what_a_view_shows_first_the_next_does_not_show_first() {
    let (scene, cameras) = (scene(), circle());
    let rays = RaySettings::default().rays(4000).occupancy(32);
    let run = Estimation::new(&scene, &cameras[..1]).rays(rays).grid(GridSettings::default().level(6));
    let field = run.run().unwrap().field;
    let candidates = [cameras[4], cameras[4]];
    let settings = settings().take(2).gain(Gain::Coverage);
    let next = NextView::new(&scene, &field, &candidates).training(&cameras[..1]).settings(settings).run().unwrap();
    let unseen: Vec<Option<f64>> = next.steps.iter().map(|step| step.unseen).collect();
    assert!(unseen[0].is_some_and(|share| share > 0.1) && unseen[1] == Some(0.0), "{unseen:?}");
}

#[test]
fn views_that_tell_nothing_gain_nothing_and_say_why() {
    let cameras = circle();
    let training = field(&samples(&cameras[..1]), 1, &MaxLevels::none(6));
    let past = Camera::look_at(DVec3::new(3.0, 0.0, 0.0), DVec3::new(6.0, 0.0, 0.0), DVec3::Z, 0.8, [SIDE, SIDE]);
    // Inside the ground, which is where z is about -0.75, and inside the box, towards the sky.
    let eye = DVec3::new(0.2, 0.2, -0.77);
    let buried = Camera::look_at(eye, DVec3::new(0.9, 0.2, -0.77), DVec3::Z, 0.8, [SIDE, SIDE]);
    let sky = Camera::look_at(DVec3::new(0.0, 0.0, 0.7), DVec3::new(0.1, 0.0, 3.0), DVec3::X, 0.8, [SIDE, SIDE]);
    let candidates = [past, buried, cameras[4], sky];
    for gain in [Gain::Logdet, Gain::Trace, Gain::Coverage] {
        let next = NextView::new(&scene(), &training, &candidates)
            .training(&cameras[..1])
            .settings(settings().take(4).gain(gain))
            .run()
            .unwrap();
        let expected = [Some(Blank::PastTheBox), Some(Blank::InMatter), None, Some(Blank::MeetsNothing)];
        assert_eq!(next.blanks, expected, "{gain:?}");
        assert!(next.gains[2] > 0.0 && [0, 1, 3].iter().all(|&k| next.gains[k] == 0.0), "{gain:?} {:?}", next.gains);
        assert_eq!((next.steps.len(), next.steps[0].index, next.complete), (1, 2, true), "{gain:?}");
    }
}

#[test]
fn a_view_of_what_is_known_is_worth_less_than_one_of_the_back() {
    let cameras = circle();
    let training = field(&samples(&cameras[..2]), 2, &MaxLevels::none(6));
    let candidates = [cameras[0], cameras[4]];
    for gain in [Gain::Logdet, Gain::Coverage] {
        let next = NextView::new(&scene(), &training, &candidates)
            .training(&cameras[..2])
            .settings(settings().gain(gain))
            .run()
            .unwrap();
        assert_eq!(next.steps[0].index, 1, "{gain:?}: {:?}", next.gains);
    }
}

#[test]
fn a_map_has_a_value_for_each_pixel_that_meets_matter() {
    let cameras = circle();
    let training = field(&samples(&cameras[..2]), 2, &uneven());
    let (scene, candidate) = (scene(), cameras[5].resized([24, 18]));
    let one = [candidate];
    let next = NextView::new(&scene, &training, &one).settings(settings());
    let map = next.map(&candidate).unwrap();
    assert_eq!((map.resolution, map.stride, map.gains.len()), ([24, 18], 1, 24 * 18));
    let gain = next.run().unwrap().gains[0];
    let sum: f64 = map.gains.iter().map(|gain| f64::from(*gain)).sum();
    let largest = map.gains.iter().copied().fold(0.0_f32, f32::max);
    // Log det is concave: pixels that meet the same vertices are worth more apart than together.
    assert!(sum > gain && f64::from(largest) < gain, "{sum} {largest} {gain}");
    // The sky is worth nothing: the courtyard fills part of the picture.
    let empty = map.gains.iter().filter(|gain| **gain == 0.0).count();
    assert!((20..400).contains(&empty), "{empty}");
    let coverage = next.settings(settings().gain(Gain::Coverage)).map(&candidate).unwrap_err().to_string();
    assert!(coverage.contains("logdet") && coverage.contains("coverage"), "{coverage}");
}

#[test]
fn what_cannot_be_ranked_is_refused_by_name() {
    let cameras = circle();
    let whole = field(&samples(&cameras[..1]), 1, &MaxLevels::none(6));
    let refusal = |field: &UncertaintyField, candidates: &[Camera], settings: Settings| {
        NextView::new(&scene(), field, candidates).settings(settings).run().unwrap_err().to_string()
    };
    let paper = whole.clone().with_lambda(whole.record().lambda).unwrap();
    let said = refusal(&paper, &cameras, settings());
    assert!(said.starts_with("scale: ") && said.contains("paper"), "{said}");
    let said = refusal(&whole.clone().without_sums(), &cameras, settings());
    assert!(said.starts_with("kept sums: "), "{said}");
    let said = refusal(&whole, &[], settings());
    assert!(said.starts_with("candidates: "), "{said}");
    let said = refusal(&whole, &cameras, settings().take(0));
    assert!(said.starts_with("views to take: ") && said.contains("0 views"), "{said}");
    let said = refusal(&whole, &cameras, settings().gain(Gain::Coverage));
    assert!(said.starts_with("cameras: "), "{said}");
}

/// Asks to stop after so many views were taken.
struct Until(std::sync::atomic::AtomicU64, u64);

impl Monitor for Until {
    fn begin(&self, stage: &str, _: u64) {
        let taken = if stage == "views" { 1 << 32 } else { 0 };
        self.0.fetch_max(taken, std::sync::atomic::Ordering::SeqCst);
    }
    fn advance(&self, _: u64) {
        // Only those of the last stage count.
        if self.0.load(std::sync::atomic::Ordering::SeqCst) >= 1 << 32 {
            self.0.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
        }
    }
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        self.0.load(std::sync::atomic::Ordering::SeqCst) >= (1 << 32) + self.1
    }
}

#[test]
fn views_taken_before_an_interruption_are_kept() -> Result<()> {
    let cameras = circle();
    let (scene, training) = (scene(), field(&samples(&cameras[..1]), 1, &MaxLevels::none(6)));
    let next = |monitor: &dyn Monitor, settings| {
        NextView::new(&scene, &training, &cameras[1..]).settings(settings).monitor(monitor).run()
    };
    let whole = next(&Silent, settings().take(5))?;
    let part = next(&Until(0.into(), 2), settings().take(5))?;
    assert!(!part.complete && part.steps.len() == 2, "{part:?}");
    assert!(part.steps.iter().zip(&whole.steps).all(|(a, b)| (a.index, a.gain) == (b.index, b.gain)));
    let none = next(&Until(0.into(), 0), settings().take(5).rescoring(Rescoring::All));
    // The first view needs no gain found anew; the second does.
    assert!(none.is_ok_and(|none| none.steps.len() == 1));
    let stopped = NextView::new(&scene, &training, &cameras).settings(settings()).monitor(&Stopped).run();
    assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
    Ok(())
}

/// Asks to stop at once.
struct Stopped;

impl Monitor for Stopped {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        true
    }
}
