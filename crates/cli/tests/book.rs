//! The commands of README and book, run as they are written.
//!
//! Blocks fenced as `sh` run from top to bottom, each page in an empty folder of its own, so that later commands find
//! what earlier ones wrote. Blocks of `sh,data` need the data of `$OCTOBAYES_DATA` and run in an ignored test. Blocks
//! of `text` are not run.

use std::path::{Path, PathBuf};
use std::process::Command;

use rayon::prelude::*;

/// What a fence may say. Whatever else looks like a shell would not be run, unnoticed.
const FENCES: [&str; 6] = ["sh", "sh,data", "text", "rust", "python", "toml"];

/// `cargo run --release -- …` is this program, and `cargo test --release` would run this test again. Any other use of
/// cargo does not belong into a block that is run. Several pages begin with the demo: the test runs it once, in the
/// folder `$DEMO`.
const PRELUDE: &str = r#"cargo() {
  if [ "$*" = "test --release" ]; then return; fi
  if [ "$1 $2 $3" != "run --release --" ]; then echo "a block that is run cannot call cargo $*" >&2; return 97; fi
  shift 3; octobayes "$@"
}
octobayes() {
  if [ "$*" = demo ]; then cp -r "$DEMO/octobayes-demo" .; else command octobayes "$@"; fi
}
"#;

/// A fenced block.
#[derive(Debug)]
struct Block {
    fence: String,
    /// Of the fence, from 1.
    line: usize,
    text: String,
}

fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for (i, line) in page.lines().enumerate() {
        match (line.strip_prefix("```"), open.as_mut()) {
            (Some(fence), None) => {
                open = Some(Block { fence: fence.trim().to_string(), line: i + 1, text: String::new() });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (None, Some(block)) => block.text += &format!("{line}\n"),
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a fence is not closed: {open:?}");
    blocks
}

/// The folder of the workspace.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// README and the pages of the book, in the book's order.
fn pages() -> Vec<PathBuf> {
    let book = root().join("docs/src");
    let summary = std::fs::read_to_string(book.join("SUMMARY.md")).unwrap();
    let linked = summary.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(page, _)| book.join(page));
    let pages: Vec<PathBuf> = [root().join("README.md")].into_iter().chain(linked).collect();
    let files = std::fs::read_dir(&book).unwrap().map(|entry| entry.unwrap().path());
    for file in files.filter(|file| file.extension().is_some_and(|e| e == "md") && !file.ends_with("SUMMARY.md")) {
        assert!(pages.contains(&file), "{} is not in SUMMARY.md", file.display());
    }
    pages
}

/// Runs the blocks of `page` whose fence is one of `fences`, up to the first that fails.
fn run(page: &Path, fences: &[&str], demo: &Path) -> Result<usize, String> {
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_octobayes"));
    let path = std::env::join_paths(
        [program.parent().unwrap().to_path_buf()]
            .into_iter()
            .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    )
    .unwrap();
    let text = std::fs::read_to_string(page).unwrap();
    let mut count = 0;
    for Block { line, text, .. } in blocks(&text).into_iter().filter(|b| fences.contains(&b.fence.as_str())) {
        let output = Command::new("sh")
            .args(["-eux", "-c", &format!("{PRELUDE}{text}")])
            .current_dir(folder.path())
            .envs([("PATH", path.as_os_str()), ("DEMO", demo.as_os_str())])
            .output()
            .unwrap();
        if !output.status.success() {
            let page = page.strip_prefix(root()).unwrap().display();
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(format!("{page}:{line}: {}\n{text}\n{said}", output.status));
        }
        count += 1;
    }
    Ok(count)
}

/// Runs blocks of all `pages`, and tells of all pages that fail.
fn run_all(pages: &[PathBuf], fences: &[&str], demo: &Path) -> usize {
    let results: Vec<_> = pages.par_iter().map(|page| run(page, fences, demo)).collect();
    let failures: Vec<&str> = results.iter().filter_map(|result| result.as_ref().err()).map(String::as_str).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    results.into_iter().flatten().sum()
}

/// The files that the book says the demo writes.
fn files_of_the_demo() -> Vec<String> {
    let page = std::fs::read_to_string(root().join("docs/src/getting-started.md")).unwrap();
    let table = page.split("All output goes to").nth(1).and_then(|rest| rest.split("\n\n").nth(1)).unwrap();
    let rows = table.lines().skip(2).filter_map(|row| row.split('|').nth(1));
    let files: Vec<String> = rows.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(str::to_owned).collect();
    assert!(files.len() > 5, "files are found at all: {files:?}");
    files
}

/// The number that stands before `words`.
fn figure(said: &str, words: &str) -> f64 {
    let number = said.split_once(words).and_then(|(before, _)| before.split_whitespace().next_back()?.parse().ok());
    number.unwrap_or_else(|| panic!("no number before {words:?}:\n{said}"))
}

/// What the demo says of itself. Beside each bound stands what seeds 0 to 3 gave. Bounds lie three ranges of these four
/// beyond them, because floating-point libraries differ as seeds do; printed digits are rounded towards the inside.
fn check_the_demo(said: &str) {
    for (words, bounds) in [
        (" dB on", 39.1..47.5),                           // 42.7 to 43.9
        (" % of the dense grid's vertices", 9.3..13.5),   // 11.1 to 11.7
        (" % of what the seen side shows", 0.0..0.1),     // at most 0.02
        (" % of what is visible from behind", 1.8..29.0), // 13.4 to 17.3
        (" % of what is made up behind", 98.1..100.01),   // 99.2 to 99.6 removed
        (" % of the true surface", 98.1..100.01),         // 99.0 kept
    ] {
        let number = figure(said, words);
        assert!(bounds.contains(&number), "{number}{words}: expected {bounds:?}");
    }
}

#[test]
#[ignore = "slow: all commands of README and book"]
fn every_command_works_as_it_is_written() {
    let demo = tempfile::tempdir().unwrap();
    let ran = Command::new(env!("CARGO_BIN_EXE_octobayes")).arg("demo").current_dir(&demo).output().unwrap();
    assert!(ran.status.success(), "octobayes demo: {}", String::from_utf8_lossy(&ran.stderr));
    check_the_demo(&String::from_utf8(ran.stdout).unwrap());
    for file in files_of_the_demo() {
        assert!(demo.path().join("octobayes-demo").join(&file).is_file(), "the demo has written no {file}");
    }
    let count = run_all(&pages(), &["sh"], demo.path());
    assert!(count > 30, "blocks are found at all: {count}");
}

#[test]
#[ignore = "needs OCTOBAYES_DATA"]
fn commands_that_need_data_work_as_they_are_written() {
    assert!(std::env::var_os("OCTOBAYES_DATA").is_some(), "OCTOBAYES_DATA is not set");
    let needy = |page: &PathBuf| blocks(&std::fs::read_to_string(page).unwrap()).iter().any(|b| b.fence == "sh,data");
    let pages: Vec<PathBuf> = pages().into_iter().filter(needy).collect();
    assert!(!pages.is_empty(), "blocks are found at all");
    // Such blocks stand on their own: what needs no data has run in the other test.
    run_all(&pages, &["sh,data"], Path::new("no demo"));
}

#[test]
fn every_verb_is_shown_and_run() {
    let mut run = String::new();
    for page in pages() {
        for Block { fence, line, text } in blocks(&std::fs::read_to_string(&page).unwrap()) {
            assert!(FENCES.contains(&fence.as_str()), "{}:{line}: a fence of another kind: {fence}", page.display());
            if fence == "sh" {
                run += &text;
            }
        }
    }
    let help = Command::new(env!("CARGO_BIN_EXE_octobayes")).arg("--help").output().unwrap().stdout;
    let help = String::from_utf8(help).unwrap();
    let commands = help.split("Commands:\n").nth(1).and_then(|rest| rest.split("\n\n").next()).unwrap();
    let verbs = commands.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let verbs: Vec<&str> = verbs.filter_map(|line| line.split_whitespace().next()).filter(|v| *v != "help").collect();
    assert!(verbs.len() > 8, "verbs are found at all: {verbs:?}");
    for verb in verbs {
        assert!(run.contains(&format!("octobayes {verb} ")), "no block that is run shows `{verb}`");
    }
}
