//! Writing of datasets: pictures, depth maps, camera files, and a record of what made them.

use std::io::{Cursor, Write};
use std::path::Path;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgba};
use serde::Serialize;

use super::mesh::{Mesh, Placement, Up};
use super::shade::{BOUNCE, LitScene, SKY_COLOR, SKY_RAYS, SUN, SUN_COLOR};
use super::staged::StagedFolder;
use super::texture::{COARSEST, FINEST};
use super::trace::{GROUND_RADIUS, MeshScene};
use super::view::{PixelSampling, TracedView, trace_view};
use super::viewpoints::{ANGLE, DISTANCE, TARGET, viewpoints};
use octobayes::geometry::{Aabb, Camera};
use octobayes::io::AtomicFile;
use octobayes::monitor::Monitor;
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_data::write_exr;

/// Depth in scene units of white, 65535, in a depth PNG. One step is 1e-4; the farthest surface
/// is less than 4.6 away.
pub const DEPTH_PNG_SCALE: f64 = 6.5535;
/// Largest picture: the most that a camera file may state.
const MAX_PIXELS: u64 = 100_000_000;

octobayes::setters! {
    /// Settings of a dataset made from a mesh.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize)]
    pub struct DatasetSettings {
        /// Axis of the file that points up.
        pub up: Up,
        /// Number of training cameras, at least 1.
        pub views: u32,
        /// Half in which they stand; `None` for all around.
        pub hemisphere: Option<Hemisphere> as into,
        /// Number of test cameras, which stand all around; at least 1.
        pub test_views: u32,
        /// Width and height in pixels.
        pub resolution: [u32; 2],
        /// Samples along x and along y of a pixel; a pixel has the square of this number.
        pub samples_per_side: u32,
        /// Seed that turns the cameras' spirals and jitters the samples. Mesh, light and texture do not depend on it.
        pub seed: u64,
    }
}

impl Default for DatasetSettings {
    fn default() -> Self {
        Self {
            up: Up::default(),
            views: 100,
            hemisphere: None,
            test_views: 20,
            resolution: [400, 400],
            samples_per_side: 4,
            seed: 0,
        }
    }
}

impl DatasetSettings {
    fn check(&self) -> Result<()> {
        let [w, h] = self.resolution.map(u64::from);
        if w == 0 || h == 0 || w * h > MAX_PIXELS {
            return Err(Error::setting("resolution", format!("1 to {MAX_PIXELS} pixels"), format!("{w} x {h}")));
        }
        let counts =
            [("views", self.views), ("test-views", self.test_views), ("samples per side", self.samples_per_side)];
        match counts.into_iter().find(|(_, count)| *count == 0) {
            Some((what, _)) => Err(Error::setting(what, "at least 1", "0")),
            None => Ok(()),
        }
    }
}

/// A group of cameras with its own file.
struct Split {
    name: &'static str,
    cameras: Vec<Camera>,
}

/// Contents of `dataset.json`.
#[derive(Serialize)]
struct Record<'a> {
    generator: String,
    mesh: String,
    vertices: usize,
    faces: usize,
    placement: Placement,
    aabb: Aabb,
    settings: &'a DatasetSettings,
    cameras: CameraRecord,
    depth: DepthRecord,
    light: LightRecord,
    texture: TextureRecord,
    ground_radius: f64,
}

#[derive(Serialize)]
struct CameraRecord {
    target: [f64; 3],
    distance: f64,
    angle_of_shorter_side: f64,
    focal: [f64; 2],
    seed_train: u64,
    seed_test: u64,
}

#[derive(Serialize)]
struct DepthRecord {
    kind: &'static str,
    unknown: f64,
    png_scale: f64,
}

#[derive(Serialize)]
struct LightRecord {
    model: &'static str,
    sun_direction: [f64; 3],
    sun_color: [f64; 3],
    sky_color: [f64; 3],
    bounce: f64,
    sky_rays: u32,
}

#[derive(Serialize)]
struct TextureRecord {
    shortest_wavelength: f64,
    longest_wavelength: f64,
}

/// A camera file with one set of intrinsics, for instant-ngp and nerfstudio.
#[derive(Serialize)]
struct Transforms {
    camera_angle_x: f64,
    camera_angle_y: f64,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    w: u32,
    h: u32,
    aabb: [[f64; 3]; 2],
    frames: Vec<FrameRecord>,
}

#[derive(Serialize)]
struct FrameRecord {
    file_path: String,
    depth_file_path: String,
    object_mask_path: String,
    transform_matrix: [[f64; 4]; 4],
}

/// Makes a dataset of the OBJ file `mesh_path` in the folder `target`, which appears only when it is complete.
///
/// # Errors
/// If the mesh cannot be read, a setting is 0 or too large, `target` is not an empty or new folder, it cannot be
/// written, or the user interrupts. Nothing is left behind then.
pub fn write_dataset(mesh_path: &Path, target: &Path, settings: &DatasetSettings, monitor: &dyn Monitor) -> Result<()> {
    settings.check()?;
    let folder = StagedFolder::create(target)?;
    let (mesh, placement) = Mesh::read(mesh_path)?.placed(settings.up);
    let [vertices, faces] = [mesh.vertices().len(), mesh.faces().len()];
    let lit = LitScene::new(MeshScene::new(mesh), monitor)?;

    // The two spirals are turned differently, so that test cameras do not coincide with training cameras.
    let seeds = [settings.seed, settings.seed ^ 0x7e57];
    let [train, test] = [
        viewpoints(settings.views, settings.hemisphere, settings.resolution, seeds[0]),
        viewpoints(settings.test_views, None, settings.resolution, seeds[1]),
    ];
    let focal = train[0].focal;
    let splits = [Split { name: "train", cameras: train }, Split { name: "test", cameras: test }];

    for name in ["images", "depth", "objects"] {
        let path = folder.path().join(name);
        std::fs::create_dir(&path).map_err(Error::io(&path, "cannot create the folder"))?;
    }
    let views = u64::from(settings.views) + u64::from(settings.test_views);
    monitor.begin("rows", views * u64::from(settings.resolution[1]));
    let mut sampling = PixelSampling { per_side: settings.samples_per_side, seed: settings.seed, view: 0 };
    for split in &splits {
        for (i, camera) in split.cameras.iter().enumerate() {
            let view = trace_view(&lit, camera, sampling, monitor)?;
            write_view(folder.path(), &frame_name(split.name, i), view)?;
            sampling.view += 1;
        }
        write_json(&folder.path().join(format!("transforms_{}.json", split.name)), &transforms(split))?;
    }
    monitor.end();

    let name = mesh_path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let record = Record {
        generator: format!("octobayes {} synth", env!("CARGO_PKG_VERSION")),
        mesh: name.clone(),
        vertices,
        faces,
        placement,
        aabb: MeshScene::bounds(),
        settings,
        cameras: CameraRecord {
            target: TARGET.to_array(),
            distance: DISTANCE,
            angle_of_shorter_side: ANGLE,
            focal,
            seed_train: seeds[0],
            seed_test: seeds[1],
        },
        depth: DepthRecord {
            kind: "euclidean distance from the camera, ray through the pixel's centre",
            unknown: 0.0,
            png_scale: DEPTH_PNG_SCALE,
        },
        light: LightRecord {
            model: "Lambertian; sun with traced shadows; sky with occlusion traced at vertices and \
                    interpolated; sRGB-encoded",
            sun_direction: SUN.normalize().to_array(),
            sun_color: SUN_COLOR.to_array(),
            sky_color: SKY_COLOR.to_array(),
            bounce: BOUNCE,
            sky_rays: SKY_RAYS,
        },
        texture: TextureRecord { shortest_wavelength: FINEST, longest_wavelength: COARSEST },
        ground_radius: GROUND_RADIUS,
    };
    write_json(&folder.path().join("dataset.json"), &record)?;
    write_bytes(&folder.path().join("README.md"), readme(&name, settings).as_bytes())?;
    folder.commit()
}

fn frame_name(split: &str, i: usize) -> String {
    format!("{split}_{i:04}")
}

/// Writes a picture as PNG, its depth as EXR (exact) and as 16-bit PNG, and a mask of the mesh.
fn write_view(folder: &Path, name: &str, view: TracedView) -> Result<()> {
    let [width, height] = view.resolution;
    let whole = "a picture has a value for each pixel";
    let rgba: Vec<u8> = view.rgba.into_iter().flatten().collect();
    let image = ImageBuffer::<Rgba<u8>, _>::from_raw(width, height, rgba).expect(whole);
    write_png(&folder.join(format!("images/{name}.png")), &image.into())?;
    let mask = view.is_object.iter().map(|is| if *is { 255 } else { 0 }).collect();
    let image = ImageBuffer::<Luma<u8>, _>::from_raw(width, height, mask).expect(whole);
    write_png(&folder.join(format!("objects/{name}.png")), &image.into())?;
    let step = |d: &f32| (f64::from(*d) / DEPTH_PNG_SCALE * 65_535.0).round() as u16;
    let steps = view.depth.iter().map(step).collect();
    let image = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, steps).expect(whole);
    write_png(&folder.join(format!("depth/{name}.png")), &image.into())?;
    write_exr(&folder.join(format!("depth/{name}.exr")), view.resolution, vec![("depth.Z", view.depth)])
}

fn write_png(path: &Path, image: &DynamicImage) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|e| Error::malformed(path, "picture", "an encodable PNG", e.to_string()))?;
    write_bytes(path, bytes.get_ref())
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut bytes = serde_json::to_vec_pretty(value).map_err(|e| Error::io(path, "cannot write")(e.into()))?;
    bytes.push(b'\n');
    write_bytes(path, &bytes)
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes).map_err(Error::io(path, "cannot write"))?;
    file.commit()
}

fn transforms(split: &Split) -> Transforms {
    let Camera { focal, center, resolution, .. } = split.cameras[0];
    let [angle_x, angle_y] = [0, 1].map(|k| 2.0 * (0.5 * f64::from(resolution[k]) / focal[k]).atan());
    let frame = |(i, camera): (usize, &Camera)| {
        let [x, y, z] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
        let row = |k: usize| [x[k], y[k], z[k], camera.position[k]];
        let name = frame_name(split.name, i);
        FrameRecord {
            file_path: format!("images/{name}.png"),
            depth_file_path: format!("depth/{name}.exr"),
            object_mask_path: format!("objects/{name}.png"),
            transform_matrix: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        }
    };
    let bounds = MeshScene::bounds();
    Transforms {
        camera_angle_x: angle_x,
        camera_angle_y: angle_y,
        fl_x: focal[0],
        fl_y: focal[1],
        cx: center[0],
        cy: center[1],
        w: resolution[0],
        h: resolution[1],
        aabb: [bounds.min().to_array(), bounds.max().to_array()],
        frames: split.cameras.iter().enumerate().map(frame).collect(),
    }
}

/// Text of the dataset's README.
fn readme(mesh: &str, settings: &DatasetSettings) -> String {
    let half = settings.hemisphere.map_or("all around".into(), |h| format!("{h:?} half only").to_lowercase());
    let DatasetSettings { views, test_views, samples_per_side: n, resolution: [w, h], seed, .. } = *settings;
    format!(
        "# `{mesh}`, ray-traced\n\n\
        Made by `octobayes synth`; every parameter is in `dataset.json`. Terms of use of the mesh apply.\n\n\
        - `transforms_train.json` ({views} cameras, {half}), `transforms_test.json` ({test_views}, all around):\n\
        \x20 intrinsics in pixels, `transform_matrix` camera-to-world, OpenGL axes (x right, y up, looking along -z).\n\
        \x20 Pixel (i, j) has its centre at (i + 0.5, j + 0.5). World: z up, front -y. Everything lies in [-1, 1]^3\n\
        \x20 (`aabb`). Seed {seed}.\n\
        - `images/*.png`: {w} x {h}, 8-bit RGBA, sRGB, straight alpha = share of {n} x {n} jittered samples that hit\n\
        \x20 geometry.\n\
        - `depth/*.exr`: 32-bit float channel `depth.Z`, Euclidean distance from the camera of the ray through the\n\
        \x20 pixel's centre, scene units; 0 where it hits nothing.\n\
        - `depth/*.png`: the same in 16 bits, distance = {DEPTH_PNG_SCALE} * value / 65535, for\n\
        \x20 `octobayes evaluate --depth depth --depth-pattern {{}}.png --depth-encoding 0,{DEPTH_PNG_SCALE}`.\n\
        - `objects/*.png`: 255 where that ray hits the mesh, 0 where it hits the ground or nothing.\n\n\
        Radiance depends on position alone: Lambertian surfaces, a sun with traced shadows, sky light with occlusion\n\
        traced at vertices and interpolated. Smooth normals and texture change colour only; depth is that of the flat\n\
        triangles.\n"
    )
}
