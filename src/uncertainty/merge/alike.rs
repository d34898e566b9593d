//! Checks that parts belong to one run, or to runs that can be added.

use super::parts::Head;
use crate::posterior::{DataScale, Scale};
use crate::rays::RaySet;
use crate::uncertainty::RunRecord;
use crate::{Error, Result};

/// Refuses parts that differ in model, cameras or a setting that affects a sum, and parts that may share rays.
pub fn check(heads: &[Head]) -> Result<()> {
    let Some((first, rest)) = heads.split_first() else { return Ok(()) };
    for (i, head) in rest.iter().enumerate() {
        check_alike(first, head)?;
        if let Some(other) = heads[..=i].iter().find(|other| may_share_rays(other, head)) {
            let found = format!("{} and {}, which may have rays in common", other.name, head.name);
            let expected = "different seeds, different shards of one run, or different sample files";
            return Err(Error::setting("fields to merge", expected, found));
        }
    }
    // What belongs together can be computed again with its sums.
    if let Some(head) = heads.iter().find(|head| !head.has_sums) {
        let found = format!("{}, which does not", head.name);
        return Err(Error::setting("kept sums", "fields that keep their sums", found));
    }
    Ok(())
}

/// Refuses parts whose differences do not show the error of their rays.
pub fn check_independent(heads: &[Head]) -> Result<()> {
    for (i, head) in heads.iter().enumerate() {
        let is_of_seed = |other: &&Head| head.ray_sets.iter().any(|a| other.ray_sets.iter().any(|b| a.seed == b.seed));
        if let Some(other) = heads[..i].iter().find(is_of_seed) {
            let expected = "different seeds: shards of one seed are not independent";
            let found = format!("{} and {} of one seed", other.name, head.name);
            return Err(Error::setting("fields to compare", expected, found));
        }
    }
    Ok(())
}

/// Whether two parts may count the same rays at the same vertices.
fn may_share_rays(a: &Head, b: &Head) -> bool {
    if a.ray_sets.is_empty() || b.ray_sets.is_empty() {
        // The ray sets of samples files are unknown; only their origin can be compared.
        let [a, b] = [&a.record, &b.record];
        return a.source == b.source || a.model_checksum.is_some() && have_one_origin(a, b);
    }
    !RaySet::are_disjoint(a.ray_sets.iter().chain(&b.ray_sets).copied())
}

/// Whether model and cameras are the same.
///
/// They are compared by checksum, whatever their paths. If a checksum is unknown, they are compared by name,
/// provided that this crate drew the rays.
fn have_one_origin(a: &RunRecord, b: &RunRecord) -> bool {
    let same = |a: Option<u32>, b: Option<u32>| a.zip(b).map(|(a, b)| a == b);
    let same = [same(a.model_checksum, b.model_checksum), same(a.cameras_checksum, b.cameras_checksum)];
    match same {
        [Some(model), Some(cameras)] => model && cameras,
        _ => !same.contains(&Some(false)) && (a.march_step.is_none() || a.source == b.source),
    }
}

/// A setting as files spell it.
fn word(setting: &impl serde::Serialize) -> String {
    match serde_json::to_value(setting) {
        Ok(serde_json::Value::String(word)) => word,
        Ok(serde_json::Value::Null) | Err(_) => "unknown".into(),
        Ok(other) => other.to_string(),
    }
}

/// Compares everything except rays, seed, shard and limits to refinement. The source is compared too if this crate drew
/// the rays.
fn check_alike(first: &Head, part: &Head) -> Result<()> {
    let known = |number: Option<f64>| number.map_or("unknown".into(), |number| number.to_string());
    let list = |numbers: Option<String>| numbers.unwrap_or("unknown".into());
    let settings = |head: &Head| {
        let p = &head.record;
        [
            ("box and level", format!("{}, level {}", head.lattice.domain(), head.lattice.level())),
            ("grid", if head.is_dense { "dense" } else { "octree" }.to_string()),
            ("lambda", p.lambda.to_string()),
            (
                "scale",
                match p.scale {
                    Scale::Data(DataScale { pixels, noise, prior_deviation }) => {
                        format!("data, {pixels} pixels of noise {noise}, prior deviation {prior_deviation}")
                    }
                    _ => "paper".into(),
                },
            ),
            ("covariance", p.covariance.name().to_string()),
            ("tolerance", p.tolerance.to_string()),
            ("march step", known(p.march_step)),
            ("gradient", word(&p.gradient)),
            ("difference step", list(p.difference_step.map(|h| format!("{h:?}")))),
            ("cutoff", known(p.cutoff)),
            ("background", list(p.background.map(|color| format!("{color:?}")))),
            ("pixel offset", known(p.pixel_offset)),
            ("pixels", word(&p.pixels)),
            ("pooling", p.pooling.to_string()),
            ("criteria", p.criteria.to_string()),
        ]
    };
    if !have_one_origin(&first.record, &part.record) {
        let name = |p: &RunRecord| {
            let sum = |sum: Option<u32>| sum.map_or("unknown".into(), |sum| format!("{sum:08x}"));
            format!("{} (model {}, cameras {})", p.source, sum(p.model_checksum), sum(p.cameras_checksum))
        };
        let what = format!("model and cameras of {}", part.name);
        let expected = format!("{}, as in {}", name(&first.record), first.name);
        return Err(Error::setting(what, expected, name(&part.record)));
    }
    for ((name, expected), (_, found)) in settings(first).into_iter().zip(settings(part)) {
        if expected != found {
            let expected = format!("{expected}, as in {}", first.name);
            return Err(Error::setting(format!("{name} of {}", part.name), expected, found));
        }
    }
    Ok(())
}
