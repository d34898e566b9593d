//! What the formatter cannot check: lines fit into 120 columns, code, comments and prose.

use std::path::{Path, PathBuf};

const COLUMNS: usize = 120;
/// What people write; tables of numbers, locks and licences have other rules.
const WRITTEN: [&str; 7] = ["rs", "md", "py", "js", "css", "glsl", "toml"];
/// What programs make: builds, environments, corpora of the fuzzer.
const MADE: [&str; 7] = ["target", "book", "corpus", "artifacts", "node_modules", "venv", "__pycache__"];

/// All files below a folder that people write.
fn written(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !name.starts_with('.') && !MADE.contains(&name) {
                found.extend(written(&path));
            }
        } else if path.extension().is_some_and(|extension| WRITTEN.iter().any(|written| *written == extension)) {
            found.push(path);
        }
    }
    found
}

/// Lines that are too long, but for rows of tables, which have to be, and what experiments write into their reports.
fn long_lines(text: &str, is_prose: bool) -> Vec<usize> {
    let mut is_generated = false;
    let too_long = |line: &str| line.chars().count() > COLUMNS;
    (1..)
        .zip(text.lines())
        .filter(|(_, line)| {
            if line.starts_with("<!-- begin generated") || line.starts_with("<!-- end generated") {
                is_generated = line.starts_with("<!-- begin");
            }
            too_long(line) && !(is_prose && (is_generated || line.trim_start().starts_with('|')))
        })
        .map(|(number, _)| number)
        .collect()
}

#[test]
fn lines_fit_into_120_columns() {
    let files = written(Path::new(env!("CARGO_MANIFEST_DIR")));
    assert!(files.len() > 500, "only {} files: is this the right folder?", files.len());
    let mut long = Vec::new();
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let is_prose = path.extension().is_some_and(|extension| extension == "md");
        long.extend(long_lines(&text, is_prose).iter().map(|number| format!("{}:{number}", path.display())));
    }
    assert!(long.is_empty(), "{} lines are longer than {COLUMNS} columns:\n{}", long.len(), long.join("\n"));
}

#[test]
fn tables_and_generated_blocks_are_left_out_of_prose_alone() {
    let long = "x".repeat(COLUMNS + 1);
    let text = format!("{long}\n| {long} |\n<!-- begin generated: a -->\n{long}\n<!-- end generated: a -->\n{long}\n");
    assert_eq!(long_lines(&text, true), [1, 6]);
    assert_eq!(long_lines(&text, false), [1, 2, 4, 6]);
    assert!(long_lines(&"é".repeat(COLUMNS), false).is_empty());
}

/// `--skip data` leaves out what needs data, and nothing else: ignored tests are slow, or have `data` in their path.
#[test]
fn ignored_tests_are_slow_or_of_data() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut count = 0;
    for path in ["src", "tests"].iter().flat_map(|folder| written(&root.join(folder))) {
        let text = std::fs::read_to_string(&path).unwrap();
        let place = path.strip_prefix(root).unwrap().display();
        for rest in text.split("\n#[ignore").chain(text.split("\n    #[ignore").skip(1)).skip(1) {
            let reason =
                rest.split('"').nth(1).unwrap_or_else(|| panic!("{place}: a test is ignored without a reason"));
            let name = rest.split("fn ").nth(1).and_then(|rest| rest.split('(').next()).unwrap();
            let is_of_data = name.contains("data") || place.to_string().contains("data");
            let is_right = match reason.split(' ').next() {
                Some("slow:") => !is_of_data,
                Some("needs") => is_of_data && reason.contains("OCTOBAYES_DATA"),
                Some("started") => !is_of_data,
                _ => false,
            };
            assert!(is_right, "{place}: `{name}` is ignored: {reason}");
            count += 1;
        }
    }
    assert!(count > 20, "ignored tests are found at all: {count}");
}
