//! Splats with their uncertainty: a `.ply` that renderers and editors of splats read.

use std::path::Path;

use glam::Vec3;

use super::leaves::code;
use octobayes::Result;
use octobayes::posterior::Scale;
use octobayes::uncertainty::{BakedField, UncertaintyField, is_certain};
use octobayes_clean::{Evidence, SHOWN, SLACK};
use octobayes_splats::Splats;

/// Writes splats with the columns `uncertainty` and `log10_uncertainty` of their centres, `seen` if the field has ray
/// coverage and, if views were looked at, `weight`, `views` and `front_share`; `seen` has their number of pixels, too.
/// With a threshold, those above it and those never seen are left out. Returns the number of splats in the file.
///
/// # Errors
/// If no splat is left, or the file cannot be written.
pub fn write_splats(
    path: &Path,
    splats: &Splats,
    field: &UncertaintyField,
    seen: Option<&(Evidence, u64)>,
    threshold: Option<f64>,
) -> Result<usize> {
    let kept = match threshold {
        Some(threshold) => is_certain(splats.means(), &BakedField::unbaked(field), threshold),
        None => vec![true; splats.len()],
    };
    let left = threshold.map(|_| splats.clone().keep(&kept)).transpose()?;
    let left = left.as_ref().unwrap_or(splats);
    let means: &[Vec3] = left.means();
    let answers = field.answers(means);
    let uncertainty: Vec<f64> = answers.iter().map(|at| at.estimate.uncertainty).collect();
    let of_kept =
        |values: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..splats.len()).filter(|&i| kept[i]).map(values).collect() };
    let record = field.record();
    let (version, prior) = (env!("CARGO_PKG_VERSION"), field.prior());
    let unit = match record.scale {
        Scale::Data(_) => "in scene units",
        Scale::Paper => "for ranking, not a length (scale `paper`)",
    };
    let mut comments = vec![format!(
        "octobayes {version} uncertainty = one standard deviation of the centre, {unit}, larger is less certain, prior \
         = {prior:e}; log10_uncertainty = its decimal logarithm"
    )];
    let mut columns: Vec<(&str, Vec<f32>)> = vec![
        ("uncertainty", uncertainty.iter().map(|&u| u as f32).collect()),
        ("log10_uncertainty", uncertainty.iter().map(|u| u.log10() as f32).collect()),
    ];
    if answers.iter().any(|at| at.observability.is_some()) {
        columns.push(("seen", answers.iter().map(|at| f32::from(code(at.observability))).collect()));
        comments.push(format!(
            "octobayes {version} seen = 0: no training ray came to the centre with half of its light; 1: rays passed; \
             2: moving it changes training pixels"
        ));
    }
    if let Some((seen, looked_at)) = seen {
        columns.push(("weight", of_kept(&|i| seen.weight[i] as f32)));
        columns.push(("views", of_kept(&|i| seen.views[i] as f32)));
        columns.push(("front_share", of_kept(&|i| seen.front_share(i) as f32)));
        comments.push(format!(
            "octobayes {version} weight = sum of the splat's shares of {looked_at} training pixels; views = training \
             views with a share above {SHOWN}; front_share = part of the weight that is nearer to the camera than where \
             half of the pixel's light is reached, by more than {SLACK} of that depth, and in empty pixels once a view \
             contradicts the splat"
        ));
    }
    if let Some(threshold) = threshold {
        comments
            .push(format!("octobayes {version} without splats of log10_uncertainty above {threshold}, or never seen"));
    }
    let columns: Vec<(&str, &[f32])> = columns.iter().map(|(name, values)| (*name, &values[..])).collect();
    left.write_ply(path, &columns, &comments)?;
    Ok(left.len())
}
