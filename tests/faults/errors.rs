//! Runs every row of `docs/errors.md`: a fault in the input, the message, the exit code. The test reads the table
//! itself, so what is promised and what happens cannot drift apart.

use std::path::{Path, PathBuf};

use crate::desk::Desk;

/// A row of the table.
struct Row {
    fault: String,
    command: String,
    /// `…` stands for any text: what the operating system or a decoder says in its own words.
    message: String,
    code: i32,
}

/// The rows of all tables that have a column "exit code".
fn rows() -> Vec<Row> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/errors.md");
    let text = std::fs::read_to_string(path).unwrap();
    // Code that contains backticks is enclosed in double ones.
    let code = |cell: &str| {
        let between = |mark| cell.strip_prefix(mark).and_then(|c| c.strip_suffix(mark));
        between("``").map(str::trim).or_else(|| between("`")).map(str::to_string)
    };
    let row = |line: &str| {
        // A vertical bar inside a cell is written `\|`.
        let line = line.replace("\\|", "\u{1}");
        let cells: Vec<String> = line.split('|').map(|cell| cell.trim().replace('\u{1}', "|")).collect();
        let [_, fault, command, message, exit, _] = cells.as_slice() else { return None };
        Some(Row { fault: fault.clone(), command: code(command)?, message: code(message)?, code: exit.parse().ok()? })
    };
    text.lines().filter(|line| line.starts_with('|')).filter_map(row).collect()
}

/// Returns true if `text` matches `pattern`, in which `…` stands for any non-empty text.
fn fits(pattern: &str, text: &str) -> bool {
    match pattern.split_once('…') {
        None => pattern == text,
        Some((start, rest)) => text
            .strip_prefix(start)
            .is_some_and(|tail| tail.char_indices().map(|(i, c)| i + c.len_utf8()).any(|i| fits(rest, &tail[i..]))),
    }
}

#[test]
fn the_table_of_errors_is_true() {
    let rows = rows();
    assert!(rows.len() >= 60, "{} rows", rows.len());
    let desk = Desk::new();
    let before = desk.files();
    let mut wrong = Vec::new();
    for Row { fault, command, message, code } in &rows {
        let args = command.strip_prefix("octobayes ").unwrap_or_else(|| panic!("`{command}` runs octobayes"));
        let (exit, out, err) = desk.run(args);
        // Notes and warnings may come first, and on a slow machine how far it is. The parser of the command line adds
        // how to get help.
        let found = err.lines().find_map(|line| line.strip_prefix("error: ")).unwrap_or_default();
        let may_come = |line: &str| ["note: ", "warning: ", "rays: "].iter().any(|start| line.starts_with(start));
        let errors = err.lines().filter(|line| !may_come(line)).count();
        let is_one_line = errors == 1 || err.contains("For more information, try '--help'");
        let left: Vec<PathBuf> = desk.files().difference(&before).cloned().collect();
        if !fits(message, found) || exit != Some(*code) || !is_one_line || !out.is_empty() || !left.is_empty() {
            let row = format!("| {fault} | `{command}` | `{}` | {} |", found.replace('|', "\\|"), exit.unwrap_or(-1));
            wrong.push(format!("{row}\n  stderr: {err:?}\n  stdout: {out:?}\n  left behind: {left:?}"));
        }
        left.iter().for_each(|path| drop(std::fs::remove_file(path)));
    }
    assert!(
        wrong.is_empty(),
        "{} rows of docs/errors.md are not what happens, which is:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// Checks that every fault has a row: one without a row would be documented nowhere.
#[test]
fn every_faulty_file_has_its_row() {
    let desk = Desk::new();
    let rows = rows();
    // The command names the file, or the message does where another file led to it.
    let text: String = rows.iter().map(|row| format!("{} {} ", row.command, row.message)).collect();
    // What the commands need besides the fault.
    let good = [
        "bare.oct",
        "good.npy",
        "good.npz",
        "r_0.png",
        "r_1.png",
        "o_0.png",
        "o_1.png",
        "foreign_0.png",
        "foreign_1.png",
        "large.png",
    ];
    for path in desk.files() {
        let name = path.file_name().unwrap().to_str().unwrap();
        let is_of_frame = |frame: &str| name.strip_prefix(frame).is_some_and(|rest| text.contains(rest));
        let pictured = ["r_0", "o_0", "o_1"].into_iter().any(is_of_frame);
        assert!(text.contains(name) || pictured || good.contains(&name), "{name} is in no row");
    }
}

#[test]
fn patterns_leave_out_only_what_they_say() {
    assert!(fits("a…c", "abc") && fits("a…", "ab") && fits("abc", "abc") && fits("…b…", "abc"));
    assert!(!fits("a…c", "ac") && !fits("abc", "abcd") && !fits("a…c", "abd") && !fits("a…", "a"));
}
