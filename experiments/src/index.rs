//! The table of all reports in `experiments/README.md`.

use std::path::{Path, PathBuf};

use octobayes::{Error, Result};

use super::report::{self, Stamp};
use super::table::Table;

/// The block of the table.
pub const BLOCK: &str = "reports";

/// All reports, by name.
pub fn reports(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(Error::io(folder, "cannot read the folder"))?;
    let paths = entries.map(|entry| entry.map(|entry| entry.path())).collect::<std::io::Result<Vec<_>>>();
    let mut paths = paths.map_err(Error::io(folder, "cannot read the folder"))?;
    paths.retain(|path| path.extension().is_some_and(|e| e == "md") && !path.ends_with("README.md"));
    paths.sort();
    Ok(paths)
}

/// The table: what a report answers (its title), its command, the minutes of all blocks together and their dates.
///
/// # Errors
/// If a report cannot be read, has no title, or a block of it no stamp.
pub fn table(folder: &Path) -> Result<String> {
    let mut table = Table::new(&["report", "question", "command", "minutes", "of processors", "date"]);
    for path in reports(folder)? {
        let text = std::fs::read_to_string(&path).map_err(Error::io(&path, "cannot read"))?;
        let title = text.lines().next().and_then(|line| line.strip_prefix("# "));
        let title = title.ok_or_else(|| Error::malformed(&path, "line 1", "a title", "none"))?;
        let mut stamps = Vec::new();
        for block in report::blocks(&text).map_err(|fault| fault.in_file(&path))? {
            let place = format!("block `{}`", block.name);
            stamps.push(Stamp::read(block.body).ok_or_else(|| Error::malformed(&path, place, "a stamp", "none"))?);
        }
        let minutes = [0, 1].map(|i| stamps.iter().map(|stamp| stamp.minutes[i]).sum::<f64>());
        // None were kept of blocks from before programs wrote them.
        let minutes = minutes.map(|m| if m > 0.0 { format!("{m:.1}") } else { "–".into() });
        let days = || stamps.iter().flat_map(|stamp| &stamp.dates);
        let date = match (days().min(), days().max()) {
            (Some(first), Some(last)) if first == last => first.clone(),
            (Some(first), Some(last)) => format!("{first} to {last}"),
            _ => return Err(Error::malformed(&path, "markers", "blocks that a program writes", "none")),
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let [wall, cpu] = minutes;
        let command = format!("`cargo experiment {name}`");
        table.row(&[format!("[{name}]({name}.md)"), title.into(), command, wall, cpu, date]);
    }
    Ok(table.text().into())
}

/// Brings the table up to date.
pub fn update(folder: &Path) -> Result<()> {
    report::rewrite(&folder.join("README.md"), BLOCK, &table(folder)?)
}
