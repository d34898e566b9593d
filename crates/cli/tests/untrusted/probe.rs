//! Reads a file and uses the result: what a reader accepts must do no harm later.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::estimate::{Checkpoint, FieldBuilder, FieldSource, GridSettings, SURFACE_POINTS};
use octobayes::field::{Intrinsics, Radiance, TrainedField};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::Covariance;
use octobayes::rays::RunProgress;
use octobayes::uncertainty::{Merging, UncertaintyField, merge};
use octobayes::{Error, Result};
use octobayes_data::OfficialGrid;
use octobayes_data::SamplesReader;
use octobayes_data::{DepthEncoding, DepthKind, DepthMap, PointReader, PosedImage, Views, scene_points};
use octobayes_models::read_voxel_grid;
use octobayes_models::{Coordinates, NerfMlp, Ppng};
use octobayes_splats::Splats;
use octobayes_synth::{Mesh, MeshScene, Up};

use super::{Kind, forge, samples};

/// Points in and around the boxes of the samples, and some that are not finite.
fn points_around(bounds: Aabb) -> Vec<Vec3> {
    let (min, max) = (bounds.min(), bounds.max());
    let at = |u: [f64; 3]| (min + DVec3::from(u) * (max - min)).as_vec3();
    let inside = [[0.5; 3], [0.0; 3], [1.0; 3], [0.49, 0.51, 0.3], [0.1, 0.9, 0.7], [0.999, 0.001, 0.25]].map(at);
    let others = [Vec3::splat(f32::NAN), Vec3::splat(f32::INFINITY), Vec3::splat(-1e30), Vec3::ZERO];
    inside.into_iter().chain(others).collect()
}

/// Reads `path` as `kind`, without using the result. Returns true if it was accepted.
pub fn open(kind: Kind, path: &Path) -> bool {
    match kind {
        Kind::Field => UncertaintyField::read(path).is_ok(),
        Kind::Checkpoint => samples::checkpoint_grids().into_iter().any(|settings| {
            let key = samples::run_key(&settings);
            let mut builder = FieldBuilder::new(settings, *key.lattice.domain()).unwrap();
            builder.restore(path, &key).is_ok()
        }),
        Kind::Ppng => Ppng::read(path, Coordinates::Ngp).is_ok(),
        Kind::Transforms => Views::read(path, None).is_ok(),
        Kind::Samples => SamplesReader::open(path).is_ok(),
        Kind::Voxels => read_voxel_grid(path).is_ok(),
        Kind::Points => points(path).is_ok(),
        Kind::Official => official(path).is_ok(),
        Kind::Safetensors | Kind::Torch => NerfMlp::read(path).is_ok(),
        Kind::Mesh => Mesh::read(path).is_ok(),
        Kind::Csv => csv(path).is_ok(),
        Kind::Image => PosedImage::read(path, [4, 3]).is_ok(),
        Kind::Exr => depth_map(path).is_ok(),
        Kind::Splats => Splats::read(path).is_ok(),
        Kind::Colmap => colmap(path).is_ok(),
    }
}

/// Reads the three files of a COLMAP model that `path` holds.
fn colmap(path: &Path) -> Result<Views> {
    let packed = std::fs::read(path).map_err(Error::io(path, "cannot read"))?;
    let (first, rest) = packed.split_first().map_or((0, &packed[..]), |(first, rest)| (*first, rest));
    let parts = forge::split(rest);
    let folder = path.with_extension("model");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir(&folder).map_err(Error::io(&folder, "cannot create"))?;
    let extension = if first % 2 == 1 { "bin" } else { "txt" };
    for (name, part) in ["cameras", "images", "points3D"].iter().zip(parts) {
        std::fs::write(folder.join(format!("{name}.{extension}")), part).map_err(Error::io(&folder, "cannot write"))?;
    }
    let views = Views::read(&folder, None)?;
    assert!(scene_points(&folder)?.iter().all(|point| point.position.is_finite()));
    Ok(views)
}

fn official(path: &Path) -> Result<UncertaintyField> {
    OfficialGrid { domain: Domain::Box(Aabb::centered_cube(1.0)), rays: 10, lambda: None }.read(path)
}

/// Reads a file by its content, and then as the `.splat` file that any bytes can be.
fn splats(path: &Path) -> Result<()> {
    let other = path.with_extension("splat");
    std::fs::copy(path, &other).map_err(Error::io(path, "cannot copy"))?;
    if let Ok(splats) = Splats::read(&other) {
        splats_are_sound(&splats, path);
    }
    Splats::read(path).map(|splats| splats_are_sound(&splats, path))
}

fn splats_are_sound(splats: &Splats, path: &Path) {
    let n = splats.len();
    assert!(n > 0 && splats.notes().iter().all(|note| !note.contains('\n')));
    for i in 0..n {
        let rotation = splats.rotation(i);
        assert!((rotation.length() - 1.0).abs() < 1e-5, "splat {i}: {rotation}");
        assert!(splats.mean(i).is_finite() && splats.mean(i).length_squared().is_finite(), "splat {i}");
        let scale = splats.scale(i);
        assert!(scale.is_finite() && scale.min_element() >= 0.0 && scale.length_squared().is_finite(), "{scale}");
        assert!((0.0..=1.0).contains(&splats.opacity(i)) && splats.sh(i).iter().all(|v| v.is_finite()));
    }
    assert_eq!(splats.summary().count, n);
    if n < 10_000 {
        let again = path.with_extension("again.ply");
        splats.write_ply(&again, &[], &[]).unwrap();
        let again = Splats::read(&again).unwrap();
        assert_eq!((again.means(), again.log_scales()), (splats.means(), splats.log_scales()));
        assert!((0..n).all(|i| again.rotation(i) == splats.rotation(i) && again.sh(i) == splats.sh(i)));
        assert_eq!(again.extra_names(), splats.extra_names());
    }
}

fn csv(path: &Path) -> Result<Vec<Vec3>> {
    std::fs::File::open(path)
        .map_err(Error::io(path, "cannot open"))
        .and_then(|file| PointReader::csv(file, path)?.rest())
}

fn points(path: &Path) -> Result<Vec<Vec3>> {
    PointReader::npy(path)?.rest()
}

/// Reads `path` as `kind` and uses the result.
///
/// # Errors
/// If the reader refuses the file.
///
/// # Panics
/// If the reader accepted nonsense.
pub fn read(kind: Kind, path: &Path) -> Result<()> {
    let outcome = match kind {
        Kind::Field => UncertaintyField::read(path).map(|field| field_is_sound(&field, path)),
        Kind::Checkpoint => checkpoint(path),
        Kind::Ppng => Coordinates::ALL.iter().try_for_each(|&c| Ppng::read(path, c).map(|m| model_is_sound(&m))),
        Kind::Transforms => Views::read(path, None).map(|views| cameras_are_sound(&views.cameras())),
        Kind::Samples => samples_are_sound(path),
        Kind::Voxels => read_voxel_grid(path).map(|grid| model_is_sound(&grid)),
        Kind::Points => points(path).map(|points| assert!(points.iter().all(|x| x.is_finite()))),
        Kind::Official => official(path).map(|field| field_is_sound(&field, path)),
        Kind::Safetensors | Kind::Torch => NerfMlp::read(path).map(|mlp| model_is_sound(&mlp)),
        Kind::Mesh => Mesh::read(path).map(|mesh| mesh_is_sound(&mesh)),
        Kind::Csv => csv(path).map(|points| assert!(points.iter().all(|x| x.is_finite()))),
        Kind::Image => picture(path),
        Kind::Exr => depth_map(path).map(|depth| depth_is_sound(&depth)),
        Kind::Splats => splats(path),
        Kind::Colmap => colmap(path).map(|views| cameras_are_sound(&views.cameras())),
    };
    if let Err(error) = &outcome {
        let text = error.to_string();
        assert!(!text.chars().any(char::is_control), "one line, without control characters: {text:?}");
        assert!(text.len() < 4096, "{} bytes of message: {text}", text.len());
    }
    outcome
}

fn field_is_sound(field: &UncertaintyField, path: &Path) {
    field.validate().expect("a field that was read is sound");
    assert!(field.prior() > 0.0 && field.prior().is_finite(), "prior {}", field.prior());
    let cube = field.lattice().domain().bounds().copied().unwrap_or(Aabb::centered_cube(3.0));
    for (x, found) in points_around(cube).into_iter().map(|x| (x, field.correlation(x, Vec3::ZERO))) {
        assert!((0.0..=1.0).contains(&found), "a correlation of {found} at {x}");
    }
    for covariance in Covariance::ALL {
        let Ok(field) = field.clone().with_covariance(covariance) else { continue };
        for (x, estimate) in points_around(cube).into_iter().map(|x| (x, field.query(x))) {
            assert!(
                estimate.uncertainty > 0.0 && estimate.uncertainty.is_finite(),
                "{covariance:?} at {x}: {estimate:?}"
            );
            assert!(
                estimate.log10_error.is_none_or(|e| e >= 0.0 && e.is_finite()),
                "{covariance:?} at {x}: {estimate:?}"
            );
        }
    }
    assert!(field.surface().iter().flatten().all(|v| v.is_finite()), "surface points are finite");
    let _ =
        (field.summary(), field.median_rays(), field.error_summary(), serde_json::to_string(field.record()).unwrap());
    if field.deviations().len() < 10_000 {
        let _ = merge(&[field.clone(), field.clone()]);
        let _ = Merging::default().error_bars(true).join(&[field.clone(), field.clone()]);
        // Level 5 of the official grid has 36,000 entries; level 9 takes a gigabyte.
        if field.lattice().level() <= 5 {
            let _ = octobayes_data::write_official(field, &path.with_extension("again.npy"));
        }
        let again = path.with_extension("again.oct");
        field.write(&again).unwrap();
        let again = UncertaintyField::read(&again).unwrap();
        // Factors are rounded each time, the rest is not.
        let same = if field.is_part() { again == *field } else { again.without_sums() == field.clone().without_sums() };
        assert!(same, "what is read can be written and read");
    }
}

fn checkpoint(path: &Path) -> Result<()> {
    let mut outcome = Ok(());
    for settings in samples::checkpoint_grids() {
        let key = samples::run_key(&settings);
        let _ = Checkpoint::new(path).rays(None);
        let mut builder = FieldBuilder::new(settings, *key.lattice.domain()).unwrap();
        outcome = builder.restore(path, &key).map(|found| {
            assert!(key.shard.admits(&found));
            builder.add(&[samples::ray_samples()]);
            if found.rays > 0 {
                let progress = RunProgress { rays: found.rays, ..RunProgress::default() };
                let field = builder.finish(&FieldSource { progress, ..FieldSource::default() }).unwrap();
                assert!(field.surface().len() <= SURFACE_POINTS, "no more points than the run keeps");
                field_is_sound(&field, path);
            }
        });
        // The other grid belongs to another lattice, so a refusal says nothing about this file.
        if !outcome.as_ref().is_err_and(|e| e.to_string().contains("run, lattice")) {
            break;
        }
    }
    outcome
}

fn model_is_sound(model: &dyn TrainedField) {
    let bounds = model.bounds();
    assert!(Aabb::new(bounds.min(), bounds.max()).is_ok(), "{bounds:?}");
    assert!(model.suggested_step() > 0.0 && model.suggested_step().is_finite(), "{}", model.suggested_step());
    let positions = points_around(bounds);
    let mut out = vec![Radiance::default(); positions.len()];
    model.evaluate(&positions, &vec![Vec3::Z; positions.len()], &mut out);
    let mut densities = vec![0.0; positions.len()];
    model.densities(&positions, &mut densities);
    let _ = model.density_bound(positions[1], positions[2]);
    if let Some(cameras) = model.cameras(&Intrinsics { fov_x: Some(1.0), resolution: None }).unwrap() {
        cameras_are_sound(&cameras);
    }
    assert!(!model.describe().contains('\n'));
    let _ = model.memory();
}

fn cameras_are_sound(cameras: &[Camera]) {
    assert!(!cameras.is_empty());
    for camera in cameras {
        let [w, h] = camera.resolution;
        assert!(w > 0 && h > 0 && camera.pixels() <= 100_000_000, "{w} x {h} pixels");
        for (x, y) in [(0.5, 0.5), (f64::from(w) - 0.5, f64::from(h) - 0.5), (0.5 * f64::from(w), 0.5 * f64::from(h))] {
            let ray = camera.ray(x, y);
            assert!(ray.origin.is_finite() && (ray.direction.length() - 1.0).abs() < 1e-9, "{ray:?} of {camera:?}");
        }
    }
}

fn samples_are_sound(path: &Path) -> Result<()> {
    let reader = SamplesReader::open(path)?;
    let settings = GridSettings::default().level(4);
    let mut builder = FieldBuilder::new(settings, Domain::Box(Aabb::centered_cube(1.0)))?;
    reader.run(&Silent, |batches| {
        builder.add(batches);
        Ok(())
    })?;
    let progress = RunProgress { rays: reader.rays_total(), samples: reader.samples(), ..RunProgress::default() };
    let field = builder.finish(&FieldSource { source: "samples".into(), progress, ..FieldSource::default() })?;
    let x = Vec3::new(0.1, 0.2, 0.3);
    assert!(field.query(x).uncertainty > 0.0, "{:?}", field.query(x));
    Ok(())
}

fn mesh_is_sound(mesh: &Mesh) {
    let up = Up::Y;
    let (placed, _) = mesh.placed(up);
    assert!(placed.vertices().iter().zip(mesh.vertices()).all(|(v, _)| v.is_finite()), "placed vertices are finite");
    if placed.faces().len() < 1000 {
        let scene = MeshScene::new(placed);
        let camera = Camera::look_at(DVec3::new(2.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z, 0.7, [2, 2]);
        for (x, y) in [(0.5, 0.5), (1.0, 1.0), (1.2, 0.8)] {
            let hit = scene.nearest(&camera.ray(x, y));
            assert!(hit.is_none_or(|hit| hit.t.is_finite()));
        }
    }
}

fn picture(path: &Path) -> Result<()> {
    let image = PosedImage::read(path, [4, 3]);
    let depth = depth_map(path);
    if let Ok(depth) = &depth {
        depth_is_sound(depth);
    }
    let image = image?;
    assert_eq!(image.len(), 12);
    for i in 0..image.len() {
        assert!(image.over(i, DVec3::ONE).is_finite());
    }
    depth.map(|_| ())
}

fn depth_map(path: &Path) -> Result<DepthMap> {
    let camera = Camera::look_at(DVec3::new(2.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 3]);
    DepthMap::read(path, DepthEncoding { offset: 0.0, scale: 10.0, kind: DepthKind::Z }, &camera, 0.5)
}

fn depth_is_sound(depth: &DepthMap) {
    assert_eq!(depth.distance.len(), 12);
    assert!(depth.distance.iter().flatten().all(|d| d.is_finite()));
}
