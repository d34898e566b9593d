//! A page of views before and after, at every strength.

use std::path::Path;

use octobayes::Result;
use octobayes::estimate::Model;
use octobayes_clean::{Reason, Strength};
use octobayes_show::comparison::{ComparedView, Comparison, Step};

use super::found::{TINTS, lines, possible};
use super::picture::Pictures;

/// Views of a page.
const VIEWS: usize = 4;

/// Writes the page, on which `strength` is shown first.
pub fn write(path: &Path, pictures: &Pictures, strength: Strength, title: &str) -> Result<()> {
    let Pictures { found, monitor, .. } = pictures;
    let strengths = possible(*found);
    let strongest = *strengths.last().expect("the one that was chosen");
    let cameras = pictures.cameras(strongest, VIEWS)?;
    let left = strengths.iter().map(|strength| found.left(*strength)).collect::<Result<Vec<_>>>()?;
    let marked: Vec<_> = strengths.iter().map(|strength| found.marked(*strength)).collect();
    // Before; then what goes and what is left of every strength.
    let steps = marked.iter().zip(&left).flat_map(|(marked, left)| [&**marked, &**left]);
    let models: Vec<&dyn Model> = std::iter::once(found.before()).chain(steps).collect();
    monitor.begin("images of the page", (models.len() * cameras.len()) as u64);
    let of_model = |model: &&dyn Model| -> Result<Vec<_>> {
        let renderer = pictures.renderer(*model)?;
        let image = |(_, camera): &(usize, &_)| {
            let panel = pictures.panel("", &*renderer, camera)?;
            monitor.advance(1);
            Ok(panel.image)
        };
        cameras.iter().map(image).collect()
    };
    let images: Vec<Vec<_>> = models.iter().map(of_model).collect::<Result<_>>()?;
    monitor.end();
    let view = |k: usize| ComparedView {
        name: format!("camera {}", cameras[k].0),
        before: images[0][k].clone(),
        steps: images[1..].chunks(2).map(|pair| [pair[0][k].clone(), pair[1][k].clone()]).collect(),
    };
    let css = |tint: glam::Vec3| {
        let [r, g, b] = tint.to_array().map(|v| (255.0 * v).round());
        format!("rgb({r}, {g}, {b})")
    };
    let counts = found.cleaned().counts(strongest);
    let shown = Reason::ALL.iter().zip(TINTS).filter(|(reason, _)| counts[**reason as usize] > 0);
    let step = |strength: &Strength| Step { name: strength.name().to_string(), lines: lines(*found, *strength) };
    let page = Comparison {
        title,
        steps: strengths.iter().map(step).collect(),
        first: strengths.iter().position(|shown| *shown == strength).unwrap_or(0),
        legend: shown.map(|(reason, (_, tint))| [css(tint), reason.name().to_string()]).collect(),
        views: (0..cameras.len()).map(view).collect(),
    };
    page.write(path)
}
