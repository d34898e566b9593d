//! A third kind of model is one file: discs that face along x, with one colour each. All that the library does with
//! fields and splats works on them.

use std::sync::Arc;

use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, Model, RaySettings};
use octobayes::geometry::{Aabb, Camera, Lattice, Ray};
use octobayes::glam::{DVec3, Vec3};
use octobayes::monitor::{Monitor, Silent};
use octobayes::posterior::Scale;
use octobayes::render::{
    CameraView, ImagePoints, Outputs, Probe, RayAverage, RaySample, RaySamples, Renderer, VisibleSegment,
    WeightedSamples,
};
use octobayes::uncertainty::BakedField;
use octobayes_evaluation::{Evaluator, Reading, TrueView, clean_up};
use octobayes_next_view::{NextView, Settings};
use octobayes_show::export::{Surfaces, surfaces, write_leaves, write_points};

/// Radius of the discs, scene units.
const RADIUS: f64 = 0.12;

#[derive(Clone)]
struct Discs {
    centers: Vec<Vec3>,
    colors: Vec<Vec3>,
}

/// A disc that a ray meets: its number, distance, and α.
type Hit = (usize, f64, f64);

impl Discs {
    /// A wall of them, and a few before it.
    fn wall() -> Self {
        let at = |i: i32| Vec3::new(if i % 13 == 0 { 0.3 } else { 0.0 }, (i % 12 - 6) as f32, (i / 12 - 6) as f32);
        let centers: Vec<Vec3> = (0..144).map(|i| at(i) * Vec3::new(1.0, 0.14, 0.14)).collect();
        let colors = (0..144).map(|i| Vec3::new((i % 5) as f32, (i % 7) as f32, (i % 3) as f32) / 7.0).collect();
        Self { centers, colors }
    }

    /// What a ray meets, from the nearest; disc `moved.0` is displaced by `moved.1`.
    fn hits(&self, ray: &Ray, moved: Option<(usize, DVec3)>) -> Vec<Hit> {
        let hit = |(i, center): (usize, &Vec3)| {
            let by = moved.filter(|(which, _)| *which == i).map_or(DVec3::ZERO, |(_, by)| by);
            let center = center.as_dvec3() + by;
            let t = (center.x - ray.origin.x) / ray.direction.x;
            let q = (ray.at(t) - center).length_squared() / RADIUS.powi(2);
            (t > 0.0 && q < 9.0).then(|| (i, t, 0.9 * (-0.5 * q).exp()))
        };
        let mut hits: Vec<Hit> = self.centers.iter().enumerate().filter_map(hit).collect();
        hits.sort_by(|a, b| a.1.total_cmp(&b.1));
        hits
    }

    fn weights(hits: &[Hit]) -> Vec<f64> {
        let mut left = 1.0;
        let weight = |hit: &Hit| {
            let before = left;
            left *= 1.0 - hit.2;
            before * hit.2
        };
        hits.iter().map(weight).collect()
    }

    fn color(&self, ray: &Ray, moved: Option<(usize, DVec3)>, background: DVec3) -> DVec3 {
        let hits = self.hits(ray, moved);
        let weights = Self::weights(&hits);
        let own: DVec3 = hits.iter().zip(&weights).map(|(hit, w)| *w * self.colors[hit.0].as_dvec3()).sum();
        own + (1.0 - weights.iter().sum::<f64>()) * background
    }
}

struct Drawn<'a> {
    discs: &'a Discs,
    background: DVec3,
}

struct View<'a> {
    drawn: &'a Drawn<'a>,
    camera: Camera,
}

impl Renderer for Drawn<'_> {
    fn bounds(&self) -> Aabb {
        self.discs.whole_box()
    }

    fn background(&self) -> DVec3 {
        self.background
    }

    fn view<'v>(&'v self, camera: &Camera, _: Outputs) -> Box<dyn CameraView + 'v> {
        Box::new(View { drawn: self, camera: *camera })
    }

    fn stands_in_matter(&self, _: &Camera, _: &[VisibleSegment]) -> bool {
        false
    }

    fn weighted(&self, views: &[(Camera, Vec<[f64; 2]>)], _: &dyn Monitor) -> Result<WeightedSamples> {
        let mut out = WeightedSamples::default();
        for ray in views.iter().flat_map(|(camera, points)| points.iter().map(|&[x, y]| camera.ray(x, y))) {
            let hits = self.discs.hits(&ray, None);
            out.weights.extend(Discs::weights(&hits));
            for (i, t, _) in hits {
                out.positions.push(self.discs.centers[i]);
                out.colors.push(self.discs.colors[i]);
                out.t.push(t);
            }
            out.offsets.push(out.positions.len());
            out.is_dropped.push(false);
        }
        Ok(out)
    }
}

impl View<'_> {
    fn segment(&self, ray: Ray) -> VisibleSegment {
        let hits = self.drawn.discs.hits(&ray, None);
        let mut left = 1.0;
        let dark = hits.iter().find(|hit| {
            left *= 1.0 - hit.2;
            left <= 0.5
        });
        VisibleSegment { ray, until: dark.map_or(f64::INFINITY, |hit| hit.1) }
    }
}

impl CameraView for View<'_> {
    fn samples(&self, points: &[ImagePoints], _: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let Drawn { discs, background } = self.drawn;
        let h = 1e-5;
        let of_points = |points: &ImagePoints| {
            let mut out = RaySamples::default();
            for (&[x, y], index) in points.at.iter().zip(points.first..) {
                let ray = self.camera.ray(x, y);
                out.sight.push(self.segment(ray));
                let hits = discs.hits(&ray, None);
                for ((i, ..), weight) in hits.iter().zip(Discs::weights(&hits)) {
                    let by = |axis: DVec3| {
                        let [after, before] = [h, -h].map(|h| discs.color(&ray, Some((*i, h * axis)), *background));
                        (after - before) / (2.0 * h)
                    };
                    let columns = DVec3::AXES.map(by);
                    let jacobian = std::array::from_fn(|k| columns[k % 3][k / 3] as f32);
                    out.push(index, RaySample { position: discs.centers[*i], jacobian, weight: weight as f32 });
                }
            }
            out
        };
        Ok(points.iter().map(of_points).collect())
    }

    fn sight(&self, points: &[ImagePoints]) -> Vec<RaySamples> {
        let of_points = |points: &ImagePoints| {
            let sight = points.at.iter().map(|&[x, y]| self.segment(self.camera.ray(x, y))).collect();
            RaySamples { sight, ..RaySamples::default() }
        };
        points.iter().map(of_points).collect()
    }
}

impl Model for Discs {
    fn kind(&self) -> &'static str {
        "discs"
    }

    fn describe(&self) -> String {
        format!("{} discs", self.centers.len())
    }

    fn whole_box(&self) -> Aabb {
        Aabb::centered_cube(1.0)
    }

    fn for_rays<'a>(&'a self, settings: &RaySettings, _: &Lattice, _: &dyn Monitor) -> Result<Arc<dyn Renderer + 'a>> {
        Ok(Arc::new(Drawn { discs: self, background: settings.background.as_dvec3() }))
    }

    fn for_images<'a>(&'a self, settings: &RaySettings, _: &dyn Monitor) -> Result<Box<dyn Renderer + 'a>> {
        Ok(Box::new(Drawn { discs: self, background: settings.background.as_dvec3() }))
    }

    fn like<'a>(&'a self, whole: &dyn Renderer) -> Box<dyn Renderer + 'a> {
        Box::new(Drawn { discs: self, background: whole.background() })
    }

    fn certain_part<'a>(&'a self, field: &'a BakedField<'a>, threshold: f64) -> Result<Option<Box<dyn Model + 'a>>> {
        let found = field.query_all(&self.centers);
        let kept: Vec<usize> = (0..found.len()).filter(|&i| found[i].uncertainty.log10() <= threshold).collect();
        if kept.is_empty() {
            return Ok(None);
        }
        let centers = kept.iter().map(|&i| self.centers[i]).collect();
        Ok(Some(Box::new(Self { centers, colors: kept.iter().map(|&i| self.colors[i]).collect() })))
    }

    fn in_matter(&self, _: Option<f64>, eyes: &[DVec3]) -> Vec<bool> {
        vec![false; eyes.len()]
    }
}

fn camera(y: f64) -> Camera {
    Camera::look_at(DVec3::new(2.5, y, 0.3), DVec3::ZERO, DVec3::Z, 0.8, [40, 32])
}

#[test]
fn all_verbs_work_on_a_third_kind_of_model() {
    let (discs, cameras) = (Discs::wall(), [-0.4, 0.0, 0.5].map(camera));
    let lattice =
        GridSettings::default().level(5).lattice(octobayes::geometry::Domain::Box(discs.whole_box())).unwrap();
    let data = octobayes::posterior::DataScale::from_cameras(&cameras, 0.03, lattice.domain()).unwrap();
    let grid = GridSettings::default().level(5).keep_sums(true).scale(Scale::Data(data));
    let run = || Estimation::new(&discs, &cameras).rays(RaySettings::default().rays(4000));
    let field = run().grid(grid).run().unwrap().field;

    // Uncertainty: discs that rays see are known better than a place that they do not, which has the prior.
    let paper = run().grid(GridSettings::default().level(5)).run().unwrap().field;
    let [seen, unseen] = [discs.centers[40], Vec3::new(-0.8, 0.8, -0.8)].map(|x| paper.query(x).uncertainty);
    assert!(
        seen < 0.1 * unseen && (unseen / paper.prior() - 1.0).abs() < 1e-6 && !field.surface().is_empty(),
        "{seen} and {unseen}"
    );
    // What it lacks is refused, as for every model that is no field.
    let refused = |run: Estimation, what: &str| {
        let error = run.prepare().err().unwrap_or_else(|| panic!("{what} is refused")).to_string();
        assert!(error.contains(what) && error.contains("discs"), "{error}");
    };
    assert!(run().grid(grid.memory(1 << 30)).prepare().is_ok(), "a budget of memory needs nothing of a model");
    refused(run().until_mean_error(0.1), "mean error");
    refused(Estimation::new(&discs, &cameras).rays(RaySettings::default().march_step(0.1)), "march step");

    // Render: the colours of the discs themselves, and U where they are.
    let renderer = discs.for_images(&RaySettings::for_images(), &Silent).unwrap();
    let probes = [Probe { field: &field, averages: &[RayAverage::WeightedMean] }];
    let view = renderer.image(&cameras[1], 0.5, &probes, &Silent).unwrap();
    let expected = discs.color(&cameras[1].ray(20.5, 16.5), None, DVec3::ONE);
    assert!((view.pixels[16 * 40 + 20].color - expected).length() < 1e-6, "{expected}");
    let averaged = view.log10_uncertainty[0][16 * 40 + 20];
    let nearest = discs.centers.iter().map(|x| field.log10(*x)).fold(f64::INFINITY, f64::min);
    assert!((nearest..field.prior().log10()).contains(&averaged), "{averaged}");

    // Evaluate: its own images are its truth, so that a clean-up that removes all is worse than one that removes none.
    let truth = TrueView {
        name: "own".into(),
        camera: cameras[1],
        whole: cameras[1],
        stride: 1,
        pixel_offset: 0.5,
        colors: view.pixels.iter().map(|pixel| pixel.color).collect(),
        kept: vec![true; view.pixels.len()],
        covered: view.pixels.iter().map(|pixel| pixel.opacity > 0.5).collect(),
        distance: view.pixels.iter().map(|p| (p.opacity > 0.5).then_some(p.median_depth + 0.01)).collect(),
        readings: octobayes_data::DepthReadings::default(),
        parts: octobayes_evaluation::TrueParts::default(),
    };
    let readings = Reading::from_field("discs", &field, None, None).unwrap();
    let evaluated = Evaluator::new(&*renderer, &readings).evaluate(&truth, 0, &Silent).unwrap();
    assert!(evaluated.pixels.len() > 100 && evaluated.absolute_error.iter().all(|error| (error - 0.01).abs() < 1e-6));
    let cleaned = clean_up(&discs, &*renderer, &BakedField::unbaked(&field), &[truth], &[-5.0, 1.0], &Silent).unwrap();
    assert!(cleaned[0].0.psnr == f64::INFINITY && cleaned[1].0.psnr < 20.0 && cleaned[2].0.psnr == f64::INFINITY);

    // Next view: from the other side more is new than from where the cameras stood.
    let behind = Camera::look_at(DVec3::new(-2.5, 0.0, 0.3), DVec3::ZERO, DVec3::Z, 0.8, [40, 32]);
    let candidates = [camera(0.05), behind];
    let next = NextView::new(&discs, &field, &candidates).settings(Settings::default().take(2).pixels(512));
    let ranking = next.run().unwrap();
    assert!(ranking.gains.iter().all(|gain| *gain > 0.0) && ranking.steps.len() == 2, "{:?}", ranking.gains);

    // Export: leaves, and points of surfaces with colours.
    let folder = tempfile::tempdir().unwrap();
    let found: Surfaces = surfaces(&*renderer, &cameras, 0.5, 10_000, &Silent).unwrap();
    assert!(found.positions.iter().all(|x| x.x.abs() < 0.5) && found.positions.len() > 100);
    write_points(&folder.path().join("points.ply"), &found, &field, None).unwrap();
    write_leaves(&folder.path().join("leaves.npz"), &field, None).unwrap();
}
