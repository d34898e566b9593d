//! Small valid files of every kind, written by the program's own writers where there is one. Nothing here is
//! anybody's data.

use std::path::Path;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use glam::{DVec3, Vec3};
use half::f16;
use minicbor::Encoder;
use octobayes::estimate::{Estimation, FieldBuilder, FieldSource, GridKind, GridSettings, RaySettings, RunKey};
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes::geometry::{Aabb, Camera, Domain, Norm};
use octobayes::posterior::{
    Covariance, Criteria, Criterion, DataScale, DensePosterior, OctreePosterior, Pooling, Posterior, Scale,
};
use octobayes::rays::{Pixels, RunProgress, Shard};
use octobayes::render::{GradientMethod, RaySample, RaySamples};
use octobayes::uncertainty::{Conformal, Support, UncertaintyField};
use octobayes_data::SamplesWriter;
use octobayes_data::write_transforms;
use octobayes_models::write_voxel_grid;
use safetensors::tensor::{Dtype, TensorView};

use super::arrays::npy;
use super::{Kind, forge, splats, torch};

/// Valid files of a kind. Each has something that the others lack.
pub fn of(kind: Kind) -> Vec<Vec<u8>> {
    match kind {
        Kind::Field => fields().iter().map(|field| written("field.oct", |path| field.write(path).unwrap())).collect(),
        Kind::Checkpoint => checkpoint_grids().map(checkpoint).to_vec(),
        Kind::Ppng => vec![ppng(1, 1), ppng(2, 2)],
        Kind::Transforms => transforms(),
        Kind::Samples => vec![samples(), few_samples()],
        Kind::Voxels => vec![written("v.npz", |path| {
            write_voxel_grid(&VoxelGrid::bake(&ClosedForm::ball(), [2, 3, 2], Vec3::Z), path).unwrap();
        })],
        Kind::Points => vec![
            npy(&[3, 3], (0..9).map(|i| i as f32 / 9.0)),
            npy(&[1, 3], [0.5, 0.25, -3.0_f64]),
            npy(&[0, 3], [0.0_f32; 0]),
        ],
        Kind::Official => vec![npy(&[27], (0..27).map(|i| i as f32))],
        Kind::Safetensors => vec![safetensors()],
        Kind::Torch => vec![torch::archive(&torch::pickle(false)), torch::stream()],
        Kind::Mesh => vec![
            b"# a tetrahedron\no t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n\
              f 1 2 3\nf 1/1 2/1 4/1\nf -4//1 -2//1 -1//1\nf 2 3 4\n"
                .to_vec(),
            b"v 0 0 0 1 0 0\nv 1e3 0 0\nv 0 2.5 -1\ng a b\nf 1/1/1 2/2/2 3/3/3\n".to_vec(),
        ],
        Kind::Csv => vec![b"name,x,y,z\n,0.5,0.25,-1\nmore,1e-3, 2 ,3\n".to_vec(), b"1,2,3\r\n\"4\",5,6\r\n".to_vec()],
        Kind::Image => images(),
        Kind::Exr => exr(),
        Kind::Splats => splats::files(),
        Kind::Colmap => colmap(),
    }
}

/// COLMAP models, as text and binary: two lenses, two pictures with and without points, two points with and without
/// pictures.
fn colmap() -> Vec<Vec<u8>> {
    let cameras = b"# cameras\n1 PINHOLE 8 6 7 7.5 4 3\n2 OPENCV 8 6 7 7 4 3 0.1 -0.01 0 1e-3\n";
    let images = b"# images\n1 1 0 0 0 0.5 0 2 1 a.png\n1.5 2 -1 3 4 7\n2 0.6 0 0.8 0 0 1 2 2 b.png\n\n";
    let floats = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let camera = |id: u32, model: u32, parameters: &[f64]| {
        [&id.to_le_bytes()[..], &model.to_le_bytes(), &8_u64.to_le_bytes(), &6_u64.to_le_bytes(), &floats(parameters)]
            .concat()
    };
    let image = |id: u32, pose: &[f64; 7], camera: u32, name: &[u8], points: &[f64]| {
        let points: Vec<u8> =
            points.chunks(2).flat_map(|xy| [floats(xy), 3_u64.to_le_bytes().to_vec()].concat()).collect();
        let count = points.len() as u64 / 24;
        let head = [&id.to_le_bytes()[..], &floats(pose), &camera.to_le_bytes(), name, &[0]].concat();
        [&head[..], &count.to_le_bytes(), &points].concat()
    };
    let lenses = [camera(1, 1, &[7.0, 7.5, 4.0, 3.0]), camera(2, 0, &[7.0, 4.0, 3.0])].concat();
    let poses = [
        image(1, &[1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 2.0], 1, b"a.png", &[1.5, 2.0, 3.0, 4.0]),
        image(2, &[0.6, 0.0, 0.8, 0.0, 0.0, 1.0, 2.0], 2, b"b.png", &[]),
    ];
    let count = 2_u64.to_le_bytes();
    let points = b"# points\n3 0.5 -1 2 255 128 0 0.25 1 0\n4 1 1 1 0 0 0 0\n";
    let point = |id: u64, position: &[f64; 3], track: &[u32]| {
        let track: Vec<u8> = track.iter().flat_map(|v| v.to_le_bytes()).collect();
        let images = (track.len() as u64 / 8).to_le_bytes();
        [&id.to_le_bytes()[..], &floats(position), &[255, 128, 0], &floats(&[0.25]), &images, &track].concat()
    };
    let scene = [point(3, &[0.5, -1.0, 2.0], &[1, 0]), point(4, &[1.0, 1.0, 1.0], &[])].concat();
    let binary = [&lenses, &poses.concat(), &scene].map(|file| [&count[..], file].concat());
    vec![forge::colmap(false, [cameras, images, points]), forge::colmap(true, [&binary[0], &binary[1], &binary[2]])]
}

/// The bytes that `write` writes.
pub fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    write(&path);
    std::fs::read(path).unwrap()
}

/// A few rays that cross the cube [−1, 1]³.
pub fn ray_samples() -> RaySamples {
    let mut out = RaySamples::default();
    for i in 0..12_u64 {
        let t = i as f32 / 12.0;
        let position = Vec3::new(0.9 * (7.0 * t).sin(), 0.5 * (11.0 * t).cos(), 0.3 - 0.2 * t);
        let jacobian = std::array::from_fn(|k| ((k as f32 + 1.0) * (3.0 * t + 1.0)).sin());
        out.push(i / 3, RaySample { position, jacobian, weight: 0.6 });
    }
    out
}

fn builder(settings: GridSettings, domain: Domain) -> FieldBuilder {
    let mut builder = FieldBuilder::new(settings, domain).unwrap();
    builder.add(&[ray_samples()]);
    builder
}

fn progress() -> RunProgress {
    RunProgress { batches: 1, rays: 5, samples: 12, ..RunProgress::default() }
}

/// The field with error bars by two groups of rays. The first met the vertices at these `points`, the second every
/// third.
fn barred<P: Posterior + Clone>(
    field: UncertaintyField,
    empty: P,
    points: impl Iterator<Item = [u32; 3]>,
) -> UncertaintyField {
    let mut groups = [empty.clone(), empty];
    for (v, (point, sums)) in points.zip(field.sums().unwrap()).enumerate() {
        groups.iter_mut().take(1 + usize::from(v % 3 == 0)).for_each(|group| group.add_sums(point, sums));
    }
    field.with_error_bars(&groups, &[3, 2]).unwrap()
}

/// Fields on octree and dense grid: with and without sums, with a calibrated interval, of contracted space, with
/// limited leaves, of a shard.
pub fn fields() -> Vec<UncertaintyField> {
    let cube = Domain::Box(Aabb::centered_cube(1.0));
    let space = Domain::contracted(DVec3::new(0.1, 0.2, 0.3), 0.5, Norm::L2).unwrap();
    let small = GridSettings::default().level(2);
    let drawn = |settings, domain, shard| {
        let source = "tests".into();
        let source = FieldSource { source, progress: progress(), shard: Some(shard), stream: None };
        builder(settings, domain).finish(&source).unwrap()
    };
    let field = |settings, domain| drawn(settings, domain, Shard::whole(5));
    let block = small.covariance(Covariance::Block).level(3).pooling(Pooling::Auto);
    let trace = small.covariance(Covariance::Trace);
    let limited = small.level(6).criteria(Criteria::from_iter([Criterion::RayCount]));
    let rays = RaySettings::default().rays(100).occupancy(8);
    let cameras = ClosedForm::half_circle(2, [8, 8]);
    let limited = Estimation::new(&ClosedForm::ball(), &cameras).rays(rays).grid(limited).run().unwrap().field;
    // Error bars, known and unknown.
    let bars = |field: UncertaintyField| {
        let lattice = *field.lattice();
        match field.support().clone() {
            Support::Octree(octree) => barred(field, OctreePosterior::new(lattice), octree.vertex_positions()),
            Support::Dense => barred(field, DensePosterior::new(lattice), (0..27).map(|v| lattice.dense_point(v))),
        }
    };
    let calibrated = |settings: GridSettings| {
        let scale = Scale::Data(DataScale::new(100, 0.1, 0.05).unwrap());
        let interval = Conformal { probability: 0.9, factor: 1.5, pixels: 100, views: 2 };
        field(settings.scale(scale), cube).with_conformal(interval)
    };
    vec![
        field(small, cube),
        field(small.level(1), cube).without_sums(),
        field(block, cube).without_sums(),
        field(trace, space),
        field(small.grid(GridKind::Dense).level(1), cube),
        limited.without_sums(),
        bars(field(small, cube)),
        bars(field(small.grid(GridKind::Dense).level(1), cube)).without_sums(),
        drawn(small, cube, Shard::new(2_000, 0, 2)),
        calibrated(small),
    ]
}

/// The grids of the sample checkpoints: all that a run can sum, each on a lattice of its own.
pub fn checkpoint_grids() -> [GridSettings; 3] {
    let octree = GridSettings::default();
    [octree.level(3), octree.level(2).keep_sums(false), octree.level(1).grid(GridKind::Dense)]
}

/// The run to which the sample checkpoint of such a grid belongs.
pub fn run_key(settings: &GridSettings) -> RunKey {
    RunKey {
        version: "1".into(),
        source: "tests".into(),
        cameras: 7,
        lattice: settings.lattice(Domain::Box(Aabb::centered_cube(1.0))).unwrap(),
        shard: Shard::whole(100_000),
        pixels: Pixels::Sobol,
        seed: 3,
        march_step: 0.1,
        gradient: GradientMethod::FiniteDifference,
        difference_step: [0.01; 3],
        cutoff: 1e-4,
        occupancy: 8,
        background: [1.0; 3],
        pixel_offset: 0.5,
        rays_per_vertex: 0.0,
        limits: 0,
    }
}

fn checkpoint(settings: GridSettings) -> Vec<u8> {
    let key = run_key(&settings);
    let mut one = FieldBuilder::new(settings, *key.lattice.domain()).unwrap();
    let mut ray = RaySamples::default();
    let sample = RaySample { position: Vec3::splat(0.1), jacobian: [0.5; 9], weight: 0.9 };
    ray.push(0, sample);
    one.add(&[ray]);
    written("run.chk", |path| one.save(path, &key, progress()).unwrap())
}

/// A Plenoptic PNG of type `kind` with as few numbers as possible.
fn ppng(kind: u64, cascades: u64) -> Vec<u8> {
    let (quants, rank, cells) = (2_u64, 1, 4_u32);
    let mut out = Vec::new();
    let mut e = Encoder::new(&mut out);
    e.map(15).unwrap();
    let integers = [
        ("qff_type", kind),
        ("n_freqs", 4),
        ("n_feats", 4),
        ("n_quants", quants),
        ("rank", rank),
        ("grid_res", u64::from(cells)),
        ("grid_mip", cascades),
    ];
    for (key, value) in integers {
        e.str(key).unwrap().u64(value).unwrap();
    }
    e.str("freqs").unwrap().array(4).unwrap();
    for f in [1.0, 2.0, 4.0, 8.0] {
        e.f64(f).unwrap();
    }
    e.str("grid_rles").unwrap().begin_array().unwrap();
    for _ in 0..cascades {
        e.array(3).unwrap().u32(3).unwrap().u32(40).unwrap().u32(21).unwrap();
    }
    e.end().unwrap();
    e.str("poses").unwrap().array(1).unwrap().array(3).unwrap();
    for row in [[1.0_f32, 0.0, 0.0, 0.4], [0.0, -1.0, 0.0, 0.6], [0.0, 0.0, -1.0, 2.5]] {
        e.array(4).unwrap();
        for v in row {
            e.f32(v).unwrap();
        }
    }
    e.str("render_step").unwrap().f64(0.01).unwrap();
    let points = if kind == 1 { quants } else { quants * quants };
    let values = |n: u64| (0..n).map(|i| (i as f32 * 0.7).sin());
    let tables: Vec<u8> = values(3 * 8 * points * rank * 4).flat_map(|v| f16::from_f32(v).to_le_bytes()).collect();
    e.str("qff_buffer").unwrap().bytes(&tables).unwrap();
    for (key, n) in [("qff_density_layer_0", 512), ("qff_color_layer_0", 512), ("qff_color_layer_1", 64)] {
        let bytes: Vec<u8> = values(n).flat_map(f32::to_le_bytes).collect();
        e.str(key).unwrap().bytes(&bytes).unwrap();
    }
    out
}

fn transforms() -> Vec<Vec<u8>> {
    let cameras: Vec<(String, Camera)> =
        ClosedForm::half_circle(2, [8, 6]).into_iter().enumerate().map(|(i, c)| (format!("r_{i}"), c)).collect();
    let pose = "[[0.5,0,0,1],[0,0.5,0,2],[0,0,0.5,3],[0,0,0,1]]";
    let blender = format!(
        r#"{{"camera_angle_x": 0.7, "k1": 0.01, "aabb_scale": 4, "frames": [{{"file_path": "./train/r_0",
        "rotation": 0.01, "transform_matrix": {pose}}}, {{"file_path": "b.jpg", "fl_x": 80, "cx": 4, "w": 8, "h": 8,
        "transform_matrix": {pose}}}]}}"#
    );
    vec![written("t.json", |path| write_transforms(path, &cameras).unwrap()), blender.into_bytes()]
}

fn samples() -> Vec<u8> {
    written("samples.npz", |path| {
        let mut writer = SamplesWriter::create(path).unwrap();
        writer.add(&[ray_samples()]).unwrap();
        writer.finish(10, 3456).unwrap();
    })
}

/// Without optional entries, and in NumPy's other integer types.
fn few_samples() -> Vec<u8> {
    let arrays =
        [npy(&[2, 3], [0.1_f32; 6]), npy(&[2, 3, 3], [1.0_f32; 18]), npy(&[2], [0_u32, 7]), npy(&[1], [10_u32])];
    forge::archive(&["positions", "jacobian", "ray", "rays_total"], &arrays.each_ref().map(Vec::as_slice))
}

/// Layers of an MLP NeRF, with the numbers of their outputs and inputs.
pub const LAYERS: [(&str, usize, usize); 8] = [
    ("layer1", 128, 63),
    ("layers_xyz.0", 128, 128),
    ("layers_xyz.1", 128, 128),
    ("layers_xyz.2", 128, 128),
    ("fc_alpha", 1, 128),
    ("fc_feat", 128, 128),
    ("layers_dir.0", 64, 155),
    ("fc_rgb", 3, 64),
];

fn safetensors() -> Vec<u8> {
    let shapes = LAYERS.iter().flat_map(|&(name, outputs, inputs)| {
        [(format!("fine.{name}.weight"), vec![outputs, inputs]), (format!("fine.{name}.bias"), vec![outputs])]
    });
    let data = vec![0; 4 * 128 * 128];
    let views = shapes.map(|(name, shape)| {
        let bytes = 4 * shape.iter().product::<usize>();
        (name, TensorView::new(Dtype::F32, shape, &data[..bytes]).unwrap())
    });
    safetensors::serialize(views, None).unwrap()
}

/// Depth alone, and among colours.
fn exr() -> Vec<Vec<u8>> {
    let depth: Vec<f32> = (0..12).map(|i| i as f32 / 3.0).collect();
    let save = |channels: Vec<(&str, Vec<f32>)>| {
        let channels = channels.into_iter().map(|(name, values)| AnyChannel::new(name, FlatSamples::F32(values)));
        let layer = Layer::new(
            (4, 3),
            LayerAttributes::default(),
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(channels.collect()),
        );
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    };
    vec![save(vec![("Z", depth.clone())]), save(vec![("R", vec![0.5; 12]), ("depth.Z", depth)])]
}

fn images() -> Vec<Vec<u8>> {
    let save = |image: image::DynamicImage, format| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    let value = |x: u32, y: u32| (40 * x + 9 * y) as u8;
    // Shades of grey, so that the same file is a depth map.
    let color = image::RgbaImage::from_fn(4, 3, |x, y| image::Rgba([value(x, y), value(x, y), value(x, y), 255]));
    let gray = image::ImageBuffer::from_fn(4, 3, |x, y| image::Luma([u16::from(value(x, y)) * 257]));
    let photo = image::RgbImage::from_fn(4, 3, |x, y| image::Rgb([value(x, y); 3]));
    vec![
        save(color.into(), image::ImageFormat::Png),
        save(gray.into(), image::ImageFormat::Png),
        save(photo.into(), image::ImageFormat::Jpeg),
    ]
}
