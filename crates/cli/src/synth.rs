//! `synth`: an exact dataset from a mesh.

use std::path::PathBuf;
use std::time::Instant;

use super::options::{choice, count, parse_resolution};
use super::progress::Bars;
use octobayes::Result;
use octobayes_data::Hemisphere;
use octobayes_session::Resolution;
use octobayes_synth::{DatasetSettings, Up, write_dataset};

/// Ray-trace a triangle mesh into a dataset: posed images and exact depth
///
/// The mesh stands on a textured disc under a sun and a sky, all in the box [-1, 1]^3. Colour depends on position
/// alone.
///
/// Writes images/*.png (RGBA), depth/*.exr (32-bit float distance from the camera, 0 where nothing is hit),
/// depth/*.png (the same in 16 bits), transforms_train.json, transforms_test.json, dataset.json and README.md. The
/// folder appears once it is complete.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes synth bunny.obj -o bunny --count 60 --hemisphere left\n\
    then: octobayes evaluate MODEL FIELD.oct --cameras bunny/transforms_test.json --depth bunny/depth \
    --depth-pattern {}.exr")]
pub struct Args {
    /// Triangle mesh (Wavefront OBJ); only positions and faces are read
    #[arg(value_name = "MESH.obj")]
    mesh: PathBuf,

    /// Folder to write; it must be new or empty
    #[arg(short, long, value_name = "DATASET")]
    output: PathBuf,

    /// Training cameras
    #[arg(
        long,
        value_name = "N",
        default_value_t = DatasetSettings::default().views,
        value_parser = count::<u32>(1..=1_000_000),
    )]
    count: u32,

    /// Put training cameras in one half only, seen from the front (y < 0; right is x > 0); test cameras stand all
    /// around
    #[arg(long, value_parser = choice::<Hemisphere>(), value_name = "HALF")]
    hemisphere: Option<Hemisphere>,

    /// Image size, WxH, or W for a square
    #[arg(long, value_name = "SIZE", value_parser = parse_resolution, default_value = "400")]
    resolution: Resolution,

    /// Test cameras
    #[arg(
        long,
        value_name = "N",
        default_value_t = DatasetSettings::default().test_views,
        value_parser = count::<u32>(1..=1_000_000),
    )]
    test_count: u32,

    /// Turns the cameras and jitters the samples; mesh, light and texture do not depend on it
    #[arg(long, default_value_t = DatasetSettings::default().seed)]
    seed: u64,

    /// Samples per pixel, a square number up to 1024
    #[arg(long, value_name = "K", value_parser = parse_square, default_value = "16")]
    samples_per_pixel: Square,

    /// Axis of the mesh that points up
    #[arg(long, value_parser = choice::<Up>(), value_name = "AXIS", default_value = Up::default().name())]
    up: Up,
}

/// A square number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Square {
    root: u32,
}

/// A square number from 1 to 1024.
fn parse_square(text: &str) -> std::result::Result<Square, String> {
    let root = text.parse::<u32>().ok().and_then(|k| (1..=32_u32).find(|n| n * n == k));
    root.map(|root| Square { root }).ok_or("expected a square number from 1 to 1024: 1, 4, 9, 16, ...".into())
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        let settings = DatasetSettings {
            up: self.up,
            views: self.count,
            hemisphere: self.hemisphere,
            test_views: self.test_count,
            // Its cameras have square images by default.
            resolution: match self.resolution {
                Resolution::Width(side) => [side; 2],
                Resolution::Size(size) => size,
            },
            samples_per_side: self.samples_per_pixel.root,
            seed: self.seed,
        };
        let start = Instant::now();
        write_dataset(&self.mesh, &self.output, &settings, bars)?;
        let pictures = self.count + self.test_count;
        let seconds = start.elapsed().as_secs_f64();
        say!(
            "{}: {pictures} pictures in {seconds:.1} s, {:.2} s each",
            self.output.display(),
            seconds / f64::from(pictures)
        )?;
        say!("box [-1, 1]^3, z up; depth for `evaluate`: --depth-pattern {{}}.exr")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_squares() {
        assert_eq!(parse_square("16"), Ok(Square { root: 4 }));
        assert_eq!(parse_square("1024"), Ok(Square { root: 32 }));
        assert!(["0", "2", "1089", "-4", "x"].iter().all(|text| parse_square(text).is_err()));
    }
}
