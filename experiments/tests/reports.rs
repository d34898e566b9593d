//! The reports of `experiments/`: all are in the table, their blocks say which version wrote them, and their commands
//! exist.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use common::index;
use common::program::folder;
use common::report::{self, Stamp};

const COMMAND: &str = "cargo experiment ";

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn reports() -> Vec<PathBuf> {
    let reports = index::reports(&folder()).unwrap();
    assert!(reports.len() >= 10, "the reports are found at all: {reports:?}");
    reports
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap().to_string_lossy().into_owned()
}

/// Names of the programs.
fn programs() -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder().join("src/bin")).unwrap();
    entries.map(|entry| name(&entry.unwrap().path())).collect()
}

#[test]
fn the_table_of_reports_is_up_to_date() {
    let readme = folder().join("README.md");
    let text = text(&readme);
    let blocks = report::blocks(&text).unwrap_or_else(|fault| panic!("{}", fault.in_file(&readme)));
    let block = blocks.iter().find(|block| block.name == index::BLOCK).expect("the table of reports");
    let table = index::table(&folder()).unwrap();
    assert_eq!(block.body, table, "every experiment brings the table up to date when it writes its report");
    for report in reports() {
        let link = format!("[{0}]({0}.md)", name(&report));
        assert!(table.contains(&link), "{link} is in the table");
    }
}

/// A report stays true of the version that made it. To measure again after every change of a number would take hours.
#[test]
fn all_blocks_say_which_version_wrote_them() {
    for path in reports() {
        let text = text(&path);
        let blocks = report::blocks(&text).unwrap_or_else(|fault| panic!("{}", fault.in_file(&path)));
        assert!(!blocks.is_empty(), "{}: nothing in it is written by a program", path.display());
        for block in blocks {
            assert!(Stamp::read(block.body).is_some(), "{}: block `{}` has no stamp", path.display(), block.name);
        }
    }
}

#[test]
fn every_report_has_its_program_and_every_program_its_report() {
    let named: BTreeSet<String> = reports().iter().map(|path| name(path)).collect();
    assert_eq!(programs(), named, "programs in src/bin, reports beside src");
}

#[test]
fn every_experiment_that_is_named_exists() {
    let root = folder().join("..");
    let pages = |folder: PathBuf| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        entries.filter(|path| path.extension().is_some_and(|e| e == "md")).collect()
    };
    let pages = [vec![root.join("README.md")], pages(folder()), pages(root.join("docs/src")), pages(root.join("docs"))];
    let (programs, mut count) = (programs(), 0);
    for page in pages.concat() {
        for rest in text(&page).split(COMMAND).skip(1) {
            let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            // NAME stands for any.
            if name != "NAME" {
                assert!(programs.contains(&name), "{}: no program `{name}`", page.display());
                count += 1;
            }
        }
    }
    assert!(count >= 2 * programs.len(), "commands are found at all: {count}");
}

#[test]
fn the_table_wants_titles_blocks_and_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let with = |text: &str| {
        std::fs::write(folder.path().join("one.md"), text).unwrap();
        index::table(folder.path()).map_err(|e| e.to_string())
    };
    let stamp = "*octobayes 0.1.0, 2026-11-22, 2 threads on 2 cores, 1.5 min of time, 2.5 min of processors.*";
    let block = |name: &str, stamp: &str| {
        format!("<!-- begin generated: {name} -->\n{stamp}\n<!-- end generated: {name} -->\n")
    };
    assert!(with("no title").unwrap_err().contains("line 1"));
    assert!(with("# Title\n").unwrap_err().contains("blocks that a program writes"));
    assert!(with(&format!("# Title\n{}", block("a", "a table"))).unwrap_err().contains("block `a`"));
    let two = format!("# Why?\n{}{}", block("a", stamp), block("b", &stamp.replace("11-22", "11-24")));
    let expected = "| [one](one.md) | Why? | `cargo experiment one` | 3.0 | 5.0 | 2026-11-22 to 2026-11-24 |";
    assert!(with(&two).unwrap().contains(expected), "minutes add up, dates reach from first to last");
}
