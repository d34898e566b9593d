//! One view before and after, and what goes in colours of its reasons.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::render::Renderer;
use octobayes_clean::Reason;
use octobayes_session::scaled;
use octobayes_show::picture::{Panel, color_panel, write_sheet};
use octobayes_splats::{SplatRenderer, Splats};

/// Cameras among which the one is looked for that shows most of the difference.
const CAMERAS: usize = 8;
/// Longest side of the images in which it is looked for, and of those that are written, pixels.
const SKETCH: f64 = 128.0;
const SIDE: f64 = 480.0;
/// The colour of each [`Reason`], in their order.
const TINTS: [(&str, Vec3); 4] = [
    ("red", Vec3::new(0.9, 0.1, 0.1)),
    ("blue", Vec3::new(0.1, 0.3, 0.9)),
    ("violet", Vec3::new(0.6, 0.1, 0.8)),
    ("orange", Vec3::new(0.95, 0.6, 0.0)),
];

/// The splats in grey, but for those that go.
fn tinted(splats: &Splats, reasons: &[Option<Reason>]) -> Splats {
    let grey = |i| 0.35 + 0.6 * splats.constant_color(i).clamp(Vec3::ZERO, Vec3::ONE).element_sum() / 3.0;
    let color = |(i, reason): (usize, &Option<Reason>)| {
        reason.map_or_else(|| Vec3::splat(grey(i)), |reason| TINTS[reason as usize].1)
    };
    splats.in_colors(&reasons.iter().enumerate().map(color).collect::<Vec<_>>())
}

/// Splats before and after, and the cameras that may show them.
pub struct BeforeAfter<'a> {
    pub splats: &'a Splats,
    pub left: &'a Splats,
    /// `[n]`: why each goes.
    pub reasons: &'a [Option<Reason>],
    pub cameras: &'a [Camera],
    pub background: Vec3,
}

impl BeforeAfter<'_> {
    /// Writes three images of the camera that shows most of what goes.
    pub fn write(&self, path: &Path, monitor: &dyn Monitor) -> Result<()> {
        let image = |splats: &Splats, camera: &Camera, side: f64| {
            let longest = f64::from(camera.resolution.into_iter().max().unwrap_or(1));
            let camera = scaled(camera, (side / longest).min(1.0));
            let view = SplatRenderer::new(splats, self.background).strided_image(&camera, 1, 0.5, &[], &[], monitor)?;
            let colors = view.pixels.iter().map(|pixel| pixel.color).collect::<Vec<DVec3>>();
            Ok((view.resolution, colors))
        };
        let mut best = (0.0, &self.cameras[0]);
        let used = self.cameras.len().min(CAMERAS);
        for camera in (0..used).map(|i| &self.cameras[i * self.cameras.len() / used]) {
            let [before, after] = [self.splats, self.left].map(|splats| image(splats, camera, SKETCH));
            let pairs = before?.1.into_iter().zip(after?.1);
            let differ = pairs.map(|(a, b)| (a - b).abs().element_sum()).sum::<f64>();
            if differ > best.0 {
                best = (differ, camera);
            }
        }
        let marked = tinted(self.splats, self.reasons);
        let named = Reason::ALL.iter().zip(TINTS).filter(|(reason, _)| self.reasons.contains(&Some(**reason)));
        let named: Vec<String> = named.map(|(reason, (color, _))| format!("{color} {reason}")).collect();
        let titles = ["before".to_string(), format!("what goes: {}", named.join(", ")), "after".to_string()];
        let panels = [self.splats, &marked, self.left].into_iter().zip(&titles).map(|(splats, title)| {
            let (resolution, colors) = image(splats, best.1, SIDE)?;
            Ok(color_panel(title, resolution, colors))
        });
        write_sheet(path, &[panels.collect::<Result<Vec<Panel>>>()?])
    }
}
