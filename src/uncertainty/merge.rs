//! Joins fields with the same box, level and protocol from different rays, as if one run had drawn all rays.

use super::{Protocol, Support, UncertaintyField};
use crate::octree::VertexId;
use crate::posterior::{DensePosterior, OctreePosterior, Refinement, VertexSums};
use crate::rays::Draw;
use crate::{Error, Result};

/// Joins `parts` into the field of all their rays.
///
/// Information adds up. Shards of one run keep all of theirs. Joined, they have the vertices of a run over all rays, at
/// any tolerance. The sums differ only by the order of f64 additions, a relative n ε for n rays at a vertex. The order
/// of the parts does not matter, bit for bit. (Sums within n ε of the negligible limit may fall on either side. With
/// criterion `density`, the shards' leaves stay, so there may be more vertices.)
///
/// Runs with other seeds left out what was negligible for their own R rays, where their octrees are coarse. The
/// total stays negligible for the sum of the R, and nothing beyond that is left out here. log10 U is within the
/// tolerance of the dense grid of all rays. Error bars of the parts are dropped, because the sums of their groups
/// are no longer available ([`merge_with_error_bars`]).
///
/// # Errors
/// If there are fewer than two parts, a part has no sums, parts differ in model, cameras or a setting that
/// affects a sum, or two of them may count the same rays.
pub fn merge(parts: &[UncertaintyField]) -> Result<UncertaintyField> {
    let [first, rest @ ..] = parts else {
        return Err(Error::setting("fields to merge", "two or more", "none"));
    };
    if rest.is_empty() {
        return Err(Error::setting("fields to merge", "two or more", "one"));
    }
    for (i, part) in rest.iter().enumerate() {
        check_alike(first, part, i + 2)?;
        for (j, other) in parts[..=i].iter().enumerate() {
            if may_share_rays(part, other) {
                let found = format!("fields {} and {}, which may have rays in common", j + 1, i + 2);
                let expected = "different seeds, different shards of one run, or different sample files";
                return Err(Error::setting("fields to merge", expected, found));
            }
        }
    }
    let parts = &in_one_order(parts)[..];
    let first = parts[0];
    let kept: Vec<&[VertexSums]> = parts
        .iter()
        .map(|part| {
            part.sums().ok_or_else(|| Error::setting("kept sums", "fields that keep their sums", "one that does not"))
        })
        .collect::<Result<_>>()?;

    // If the rays of one field are unknown, so are those of the whole.
    let draws = if parts.iter().any(|part| part.draws.is_empty()) {
        Vec::new()
    } else {
        Draw::joined(parts.iter().flat_map(|part| &part.draws).copied())
    };
    let protocol = joined_protocol(parts, &draws);
    let most = parts.iter().map(|part| part.surface.len()).max().unwrap_or(0);
    let surface = parts.iter().flat_map(|part| &part.surface).copied().take(most).collect();
    let mut visits = first.visits.clone();
    for part in &parts[1..] {
        // If it is not known where the rays of one field passed, it is not known of the whole.
        visits = visits.zip(part.visits.as_ref()).map(|(mut sum, more)| {
            sum += more;
            sum
        });
    }
    match &first.support {
        Support::Dense => {
            let mut sums = DensePosterior::new(first.lattice).into_sums();
            for part in kept {
                sums.iter_mut().zip(part).for_each(|(sum, more)| *sum += more);
            }
            Ok(UncertaintyField::new(protocol, first.lattice, Support::Dense, sums)
                .with_surface(surface)
                .with_draws(draws)
                .with_visits(visits))
        }
        Support::Octree(_) => {
            // What was refined for reasons other than information stays refined.
            let mut wanted = Vec::new();
            if protocol.criteria.density || protocol.criteria.uniform {
                for part in parts {
                    let Support::Octree(octree) = &part.support else { continue };
                    octree.cells().for_each_leaf(|leaf| wanted.push(leaf));
                }
            }
            let mut posterior = OctreePosterior::limited(first.lattice, first.limits.clone());
            for (part, kept) in parts.iter().zip(kept) {
                let Support::Octree(octree) = &part.support else { continue };
                for (point, e) in octree.vertex_positions().zip(kept) {
                    posterior.add_sums_at(point, e);
                }
            }
            let floor = joined_floor(parts, &draws);
            let field = UncertaintyField::from_octree_above(floor, protocol, first.lattice, posterior, wanted);
            Ok(field.with_surface(surface).with_draws(draws).with_visits(visits))
        }
    }
}

/// Same as [`merge`], with error bars. The parts are the groups of rays that the jackknife compares, whether or
/// not they have error bars themselves.
///
/// # Errors
/// As [`merge`], or if two parts are shards of one low-discrepancy sequence. They complement each other, so their
/// differences would overstate the error.
pub fn merge_with_error_bars(parts: &[UncertaintyField]) -> Result<UncertaintyField> {
    let merged = merge(parts)?;
    for (i, part) in parts.iter().enumerate() {
        let same = |other: &UncertaintyField| part.draws.iter().any(|a| other.draws.iter().any(|b| a.seed == b.seed));
        if let Some(j) = parts[..i].iter().position(same) {
            let found = format!("fields {} and {} of one seed", j + 1, i + 1);
            return Err(Error::setting(
                "fields to compare",
                "different seeds: shards of one seed are not independent",
                found,
            ));
        }
    }
    let at = |part: &UncertaintyField| -> Vec<VertexSums> {
        let own = part.sums().unwrap_or_default();
        match (&merged.support, &part.support) {
            (Support::Octree(whole), Support::Octree(octree)) => {
                let vertex = |point| octree.vertex(point).map_or(VertexSums::default(), |VertexId(v)| own[v as usize]);
                whole.vertex_positions().map(vertex).collect()
            }
            _ => own.to_vec(),
        }
    };
    let parts = in_one_order(parts);
    let groups: Vec<Vec<VertexSums>> = parts.iter().map(|part| at(part)).collect();
    let rays: Vec<u64> = parts.iter().map(|part| part.protocol.rays).collect();
    Ok(merged.with_error_bars(&groups, &rays))
}

/// The parts by seed and shard, so that what is joined does not depend on the order in which they are given, bit for
/// bit: f64 additions do not commute over three summands.
fn in_one_order(parts: &[UncertaintyField]) -> Vec<&UncertaintyField> {
    let mut parts: Vec<&UncertaintyField> = parts.iter().collect();
    let key = |draw: &Draw| (draw.seed, draw.shard.rays, draw.shard.of, draw.shard.index);
    parts.sort_by(|a, b| {
        let by_draws = a.draws.iter().map(key).cmp(b.draws.iter().map(key));
        by_draws.then_with(|| a.protocol.source.cmp(&b.protocol.source))
    });
    parts
}

/// Whether two fields may count the same rays.
fn may_share_rays(a: &UncertaintyField, b: &UncertaintyField) -> bool {
    if a.draws.is_empty() || b.draws.is_empty() {
        // The draws of samples files are unknown; only their origin can be compared.
        let [a, b] = [&a.protocol, &b.protocol];
        return a.source == b.source || a.origin.model.is_some() && a.origin == b.origin;
    }
    !Draw::are_disjoint(a.draws.iter().chain(&b.draws).copied())
}

/// Whether model and cameras are the same.
///
/// They are compared by checksum, whatever their paths. If a checksum is unknown, they are compared by name,
/// provided that this crate drew the rays.
fn have_one_origin(a: &Protocol, b: &Protocol) -> bool {
    let same = |a: Option<u32>, b: Option<u32>| a.zip(b).map(|(a, b)| a == b);
    let same = [same(a.origin.model, b.origin.model), same(a.origin.cameras, b.origin.cameras)];
    match same {
        [Some(model), Some(cameras)] => model && cameras,
        _ => !same.contains(&Some(false)) && (a.march_step.is_none() || a.source == b.source),
    }
}

/// Compares everything except rays, seed and shard. The source is compared too if this crate drew the rays.
fn check_alike(first: &UncertaintyField, part: &UncertaintyField, number: usize) -> Result<()> {
    let settings = |field: &UncertaintyField| {
        let p = &field.protocol;
        let kind = if matches!(field.support, Support::Dense) { "dense" } else { "octree" };
        [
            ("box and level", format!("{:?}", field.lattice)),
            ("grid", kind.to_string()),
            ("lambda", p.lambda.to_string()),
            ("scale", format!("{:?}", p.scale)),
            ("covariance", p.covariance.name().to_string()),
            ("tolerance", p.tolerance.to_string()),
            ("march step", format!("{:?}", p.march_step)),
            ("gradient", format!("{:?}", p.gradient)),
            ("difference step", format!("{:?}", p.difference_step)),
            ("cutoff", format!("{:?}", p.cutoff)),
            ("background", format!("{:?}", p.background)),
            ("pixel offset", format!("{:?}", p.pixel_offset)),
            ("pixels", format!("{:?}", p.pixels)),
            ("prior", format!("{:?}", p.prior)),
            ("min rays", p.min_rays.to_string()),
            ("criteria", p.criteria.to_string()),
            (
                "limits to refinement",
                format!("{:08x}", crc32fast::hash(format!("{:?}", field.limits.packed()).as_bytes())),
            ),
        ]
    };
    if !have_one_origin(&first.protocol, &part.protocol) {
        let name = |p: &Protocol| {
            let sum = |sum: Option<u32>| sum.map_or("unknown".into(), |sum| format!("{sum:08x}"));
            format!("{} (model {}, cameras {})", p.source, sum(p.origin.model), sum(p.origin.cameras))
        };
        let what = format!("model and cameras of field {number}");
        return Err(Error::setting(what, format!("{}, as in field 1", name(&first.protocol)), name(&part.protocol)));
    }
    for ((name, expected), (_, found)) in settings(first).into_iter().zip(settings(part)) {
        if expected != found {
            return Err(Error::setting(
                format!("{name} of field {number}"),
                format!("{expected}, as in field 1"),
                found,
            ));
        }
    }
    Ok(())
}

/// The information that may still be left out where octrees are joined: together with what the parts left out,
/// it is negligible for all rays.
///
/// Shards lack nothing, and nothing is left out as long as some shards are missing. A vertex that the octree of a
/// whole run lacks may have lost what was negligible for the rays of that run. Every vertex considered here
/// belongs to some part, whose sums are complete there.
fn joined_floor(parts: &[&UncertaintyField], draws: &[Draw]) -> f64 {
    if draws.iter().any(Draw::is_part) {
        return Refinement::EVERYTHING;
    }
    let of_shards = parts.iter().flat_map(|part| &part.draws).filter(|draw| draw.is_part());
    let complete = of_shards.fold(0_u64, |sum, draw| sum.saturating_add(draw.shard.own_rays()));
    let runs = parts.iter().map(|part| part.protocol.rays);
    parts[0].protocol.floor(if complete > 0 { complete } else { runs.min().unwrap_or(0) })
}

/// The protocol of the joined run of these draws. It is a whole run again if all its shards are present.
fn joined_protocol(parts: &[&UncertaintyField], draws: &[Draw]) -> Protocol {
    let protocols = || parts.iter().map(|part| &part.protocol);
    let first = &parts[0].protocol;
    let one_seed = first.seed.filter(|_| protocols().all(|p| p.seed == first.seed));
    let whole = match draws {
        [draw] if one_seed == Some(draw.seed) => Some(draw.shard),
        _ => None,
    };
    let mut sources: Vec<&str> = protocols().map(|p| p.source.as_str()).collect();
    sources.dedup();
    Protocol {
        source: sources.join(" + "),
        rays: protocols().fold(0, |sum, p| sum.saturating_add(p.rays)),
        dropped: protocols().fold(0, |sum, p| sum.saturating_add(p.dropped)),
        seed: one_seed,
        shard: whole,
        ..first.clone()
    }
}
