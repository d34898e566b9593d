//! Models with their training cameras.

use std::path::Path;

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Intrinsics, TrainedField};
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::Views;
use octobayes_models::Coordinates;
use octobayes_models::open;
use octobayes_synth::{DatasetSettings, Up, write_dataset};
use octobayes_train::{DatasetFiles, TrainSettings};

use super::train::hash_grid;

/// A model with its training cameras, and how it is studied unless an experiment says otherwise.
pub struct Scene {
    /// Name in tables.
    pub name: &'static str,
    pub field: Box<dyn TrainedField>,
    pub cameras: Vec<Camera>,
    pub settings: RaySettings,
    pub grid: GridSettings,
}

impl Scene {
    /// The closed-form courtyard seen from one side.
    #[must_use]
    pub fn courtyard() -> Self {
        Self {
            name: "courtyard",
            field: Box::new(ClosedForm::courtyard()),
            cameras: ClosedForm::half_circle(40, [400, 400]),
            settings: RaySettings::default().rays(204_800),
            grid: GridSettings::default().level(7),
        }
    }

    /// A built-in closed-form scene with the cameras that it brings.
    ///
    /// # Errors
    /// If there is none of this name.
    pub fn built_in(name: &'static str) -> Result<Self> {
        let field = ClosedForm::named(name)?;
        let cameras = field.cameras(&Intrinsics::default())?.unwrap_or_default();
        let settings = RaySettings::default().rays(51_200);
        Ok(Self { name, field: Box::new(field), cameras, settings, grid: GridSettings::default().level(6) })
    }

    /// The closed-form city of 512 m with the cameras of its drive.
    pub fn city() -> Result<Self> {
        let city = Self::built_in("city")?;
        let settings = RaySettings::default().rays(204_800).occupancy(512);
        Ok(Self { settings, grid: GridSettings::default(), ..city })
    }

    /// The trained lego: a Plenoptic PNG of type 1 with the 100 training cameras of its data set, 400 × 400.
    pub fn lego(data: &Path) -> Result<Self> {
        let model = data.join("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
        Ok(Self {
            name: "lego, Plenoptic PNG",
            field: open(&model.to_string_lossy(), Some(Coordinates::Blender))?,
            cameras: lego_cameras(data)?,
            settings: RaySettings::default().rays(409_600),
            grid: GridSettings::default(),
        })
    }

    /// The trained lego as an MLP of nerf-pytorch, with the same cameras.
    pub fn lego_mlp(data: &Path) -> Result<Self> {
        let model = data.join("nerf-mlp-pretrained/lego.safetensors");
        Ok(Self {
            name: "lego, MLP",
            field: open(&model.to_string_lossy(), None)?,
            cameras: lego_cameras(data)?,
            settings: RaySettings::default().rays(409_600),
            grid: GridSettings::default(),
        })
    }

    /// A captured object: a statue filmed from around it (Tanks and Temples).
    pub fn ignatius(data: &Path) -> Result<Self> {
        own_poses(data, "TanksAndTemple/ppng_1/Ignatius.ppng", "Ignatius (captured)", 50.0, Vec3::ONE)
    }

    /// An unbounded scene in the model's own box (mip-NeRF 360).
    pub fn garden(data: &Path) -> Result<Self> {
        let garden = own_poses(data, "360_v2/ppng_1/garden.ppng", "garden (unbounded)", 60.0, Vec3::ZERO)?;
        // A ray meets matter nearly everywhere: it takes ten times as long as one of lego.
        Ok(Self { settings: garden.settings.rays(204_800), ..garden })
    }

    /// An unbounded scene that is meant to be contracted (mip-NeRF 360).
    pub fn bicycle(data: &Path) -> Result<Self> {
        let bicycle = own_poses(data, "360_v2/ppng_1/bicycle.ppng", "bicycle (unbounded)", 60.0, Vec3::ZERO)?;
        Ok(Self { settings: bicycle.settings.rays(102_400), ..bicycle })
    }

    /// A hash grid that is trained here, once in `folder`, on a hundred pictures of a scanned mesh from all around.
    ///
    /// # Errors
    /// If the mesh cannot be read or the folder not be written.
    pub fn armadillo(data: &Path, folder: &Path) -> Result<Self> {
        const STEPS: u64 = 2000;
        let images = folder.join("armadillo");
        if !images.exists() {
            let settings = DatasetSettings::default().up(Up::Y).views(100).test_views(1);
            let settings = settings.resolution([200; 2]).samples_per_side(2);
            write_dataset(&data.join("meshes/armadillo.obj"), &images, &settings, &Silent)?;
        }
        let files = DatasetFiles::read(&images)?;
        let [shots, _] = files.load(&Silent)?;
        let model = folder.join("armadillo.safetensors");
        if !model.exists() {
            hash_grid(TrainSettings::default(), Domain::Box(files.bounds), &shots, STEPS)?.write(&model)?;
        }
        Ok(Self {
            name: "armadillo (trained hash grid)",
            field: open(&model.to_string_lossy(), None)?,
            cameras: shots.iter().map(|shot| shot.camera).collect(),
            settings: RaySettings::default().rays(204_800),
            grid: GridSettings::default(),
        })
    }

    /// The same field with more points on visible surfaces to compare at than a run keeps: those that its rays see
    /// first.
    ///
    /// # Errors
    /// As [`RaySettings::stream`].
    pub fn with_surfaces(&self, field: UncertaintyField, rays: RaySettings, points: usize) -> Result<UncertaintyField> {
        let stream = rays.stream(&self.field, &self.cameras, field.lattice(), &Silent)?;
        Ok(field.with_surface(stream.surface_points(points, rays.rays, &Silent)?))
    }

    /// An estimation of this scene with these settings.
    pub fn estimation(&self, rays: RaySettings, grid: GridSettings) -> Estimation<'_> {
        Estimation::new(&self.field, &self.cameras).rays(rays).grid(grid)
    }
}

fn lego_cameras(data: &Path) -> Result<Vec<Camera>> {
    Ok(Views::read(&data.join("nerf-mlp-pretrained/cameras/lego_train.json"), Some([400, 400]))?.cameras())
}

/// A Plenoptic PNG with its own poses; the lens has `fov` degrees along x.
fn own_poses(data: &Path, file: &str, name: &'static str, fov: f64, background: Vec3) -> Result<Scene> {
    let field = open(&data.join("ppng-pretrained").join(file).to_string_lossy(), Some(Coordinates::Ngp))?;
    let intrinsics = Intrinsics { fov_x: Some(fov.to_radians()), resolution: Some([400, 300]) };
    let cameras = field.cameras(&intrinsics)?.unwrap_or_default();
    let settings = RaySettings::default().rays(409_600).background(background);
    Ok(Scene { name, field, cameras, settings, grid: GridSettings::default() })
}
