//! What `clean` finds in a model of any kind, and how it reports that.

use std::path::Path;

use glam::Vec3;
use octobayes::estimate::Model;
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};
use octobayes_clean::{Cleaned, Reason, Strength};
use serde_json::{Value, json};

/// The colour of each [`Reason`], in their order.
pub const TINTS: [(&str, Vec3); Reason::ALL.len()] = [
    ("red", Vec3::new(0.9, 0.1, 0.1)),
    ("blue", Vec3::new(0.1, 0.3, 0.9)),
    ("violet", Vec3::new(0.6, 0.1, 0.8)),
    ("orange", Vec3::new(0.95, 0.6, 0.0)),
    ("green", Vec3::new(0.0, 0.6, 0.3)),
];

/// The grey of what stays, from its colour.
pub fn grey(color: Vec3) -> Vec3 {
    Vec3::splat(0.35 + 0.6 * color.clamp(Vec3::ZERO, Vec3::ONE).element_sum() / 3.0)
}

/// A model, the parts that it is made of, and what goes of them.
pub trait Found {
    /// What its parts are called.
    fn parts(&self) -> &'static str;

    /// The parts and what goes of them.
    fn cleaned(&self) -> &Cleaned;

    /// The number of part `i` in its file, or of its cell in the grid, x fastest.
    fn number(&self, i: usize) -> usize;

    /// Where part `i` is, scene units.
    fn center(&self, i: usize) -> Vec3;

    /// The model as it was.
    fn before(&self) -> &dyn Model;

    /// What is left of it at a strength.
    fn left(&self, strength: Strength) -> Result<Box<dyn Model + '_>>;

    /// The model in grey, but for what goes at a strength: that has the colour of its [reason](TINTS).
    fn marked(&self, strength: Strength) -> Box<dyn Model + '_>;
}

/// The reasons for which parts go at a strength, with their colours: `red floating`.
pub fn legend(found: &dyn Found, strength: Strength) -> Vec<String> {
    let named =
        Reason::ALL.iter().zip(found.cleaned().counts(strength)).zip(TINTS).filter(|((_, count), _)| *count > 0);
    named.map(|((reason, _), (color, _))| format!("{color} {reason}")).collect()
}

/// Counts of all reasons and strengths.
pub fn counts(found: &dyn Found, strength: Strength) -> Value {
    let cleaned = found.cleaned();
    let of = |strength: Strength| -> Value {
        let counts = cleaned.counts(strength);
        Reason::ALL.iter().map(|reason| (reason.name().to_string(), json!(counts[*reason as usize]))).collect()
    };
    let by_strength: Value =
        Strength::ALL.iter().map(|&strength| (strength.name().to_string(), of(strength))).collect();
    let (n, gone) = (cleaned.removals.len(), cleaned.counts(strength).iter().sum::<usize>());
    json!({
        found.parts(): n,
        "left": n - gone,
        "reasons": of(strength),
        "reasons_by_strength": by_strength,
        "pixels": cleaned.pixels[0],
        "looks": cleaned.looks,
    })
}

/// The strengths that leave something.
pub fn possible(found: &dyn Found) -> Vec<Strength> {
    let leaves = |strength: &Strength| found.cleaned().removed(*strength).contains(&None);
    Strength::ALL.into_iter().filter(leaves).collect()
}

/// Refuses a strength that leaves nothing.
pub fn check_strength(found: &dyn Found, strength: Strength) -> Result<()> {
    if possible(found).contains(&strength) {
        return Ok(());
    }
    let (parts, n) = (found.parts(), found.cleaned().removals.len());
    let was = format!("{strength}, at which all {n} {parts} go");
    Err(Error::setting("--strength", format!("one that leaves some {parts}"), was))
}

/// How many parts go at a strength, and how many of them for which reason.
pub fn lines(found: &dyn Found, strength: Strength) -> Vec<String> {
    let (cleaned, parts) = (found.cleaned(), found.parts());
    let (n, counts) = (cleaned.removals.len(), cleaned.counts(strength));
    let share = |count: usize| 100.0 * count as f64 / n as f64;
    let gone: usize = counts.iter().sum();
    let all = format!("removed {gone} of {n} {parts} ({:.2} %), {strength}:", share(gone));
    let each = Reason::ALL.iter().zip(counts).filter(|(_, count)| *count > 0);
    let each = each.map(|(reason, count)| format!("{count:>9} {} ({:.2} %)", reason.sentence(), share(count)));
    std::iter::once(all).chain(each).collect()
}

/// Tells people what goes.
pub fn announce_counts(found: &dyn Found, strength: Strength) {
    lines(found, strength).iter().for_each(|line| announce!("{line}"));
    let cleaned = found.cleaned();
    let share = |strength: Strength| {
        100.0 * cleaned.counts(strength).iter().sum::<usize>() as f64 / cleaned.removals.len() as f64
    };
    let others = Strength::ALL.into_iter().filter(|other| *other != strength);
    let others: Vec<String> = others.map(|strength| format!("{strength} {:.2} %", share(strength))).collect();
    announce!("other values of --strength: {}", others.join(", "));
}

/// Writes a row for every part.
pub fn write_report(path: &Path, found: &dyn Found) -> Result<()> {
    let failed = |e: csv::Error| Error::io(path, "cannot write")(e.into());
    let mut table = csv::Writer::from_writer(AtomicFile::create(path)?);
    let part = found.parts().trim_end_matches('s');
    let head = [part, "x", "y", "z", "reason", "strength", "score", "front_share", "weight", "peak", "views"];
    let Cleaned { removals, evidence: of, scores, uncertainty, .. } = found.cleaned();
    table.write_record(head.into_iter().chain(uncertainty.as_ref().map(|_| "uncertainty"))).map_err(failed)?;
    for (i, removal) in removals.iter().enumerate() {
        let [x, y, z] = found.center(i).to_array().map(|v| v.to_string());
        let (reason, strength) = removal.map_or(("kept", ""), |r| (r.reason.name(), r.strength.name()));
        let row = [
            found.number(i).to_string(),
            x,
            y,
            z,
            reason.into(),
            strength.into(),
            format!("{:.4}", scores[i]),
            format!("{:.4}", of.front_share(i)),
            format!("{:.3e}", of.weight[i]),
            format!("{:.4}", of.peak[i]),
            of.views[i].to_string(),
        ];
        let uncertainty = uncertainty.as_ref().map(|u| format!("{:.4e}", u[i].uncertainty));
        table.write_record(row.into_iter().chain(uncertainty)).map_err(failed)?;
    }
    let file = table.into_inner().map_err(|e| Error::io(path, "cannot write")(e.into_error()))?;
    file.commit()
}
