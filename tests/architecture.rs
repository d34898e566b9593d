//! What `docs/architecture.md` says of the modules of `src/`, held against the imports: its rules, no cycles, and files
//! that exist. The rules are read by this test, so that page and code cannot part.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// `crate::room` in the code of another room.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Import {
    from: String,
    to: String,
    /// File and line, from the package's root.
    place: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// All Rust files below `folder`.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// The code without comments and without what is compiled for tests only, line by line. Second, the names of modules
/// that are compiled for tests only.
fn production(text: &str) -> (Vec<String>, Vec<String>) {
    let lines: Vec<&str> = text.lines().collect();
    let (mut code, mut test_modules) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < lines.len() {
        if lines[at].trim() != "#[cfg(test)]" {
            let line = lines[at];
            code.push(line.find("//").map_or(line, |comment| &line[..comment]).to_string());
            at += 1;
            continue;
        }
        // The item that follows ends on its first line, or with a brace that is no further indented.
        let start = at;
        let end = format!("{}}}", &lines[at][..lines[at].len() - lines[at].trim_start().len()]);
        at += 1;
        while lines[at].trim_start().starts_with('#') {
            at += 1;
        }
        let item = lines[at].trim();
        if let Some(module) = item.strip_suffix(';').and_then(|item| item.split("mod ").nth(1)) {
            test_modules.push(module.to_string());
        }
        if !item.ends_with([';', ',', '}']) {
            while !lines[at].starts_with(&end) {
                at += 1;
            }
        }
        at += 1;
        code.extend((start..at).map(|_| String::new()));
    }
    (code, test_modules)
}

/// The first names of what follows a path prefix: of `a::b` it is `a`, of `{a, b::{c, d}, e}` they are `a`, `b` and
/// `e`.
fn first_names(rest: &str) -> Vec<String> {
    let name = |text: &str| -> String { text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect() };
    let Some(group) = rest.strip_prefix('{') else { return vec![name(rest)] };
    let (mut depth, mut names, mut begins) = (0, Vec::new(), true);
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => begins = true,
            c if begins && !c.is_whitespace() => {
                names.push(name(&group[i..]));
                begins = false;
            }
            _ => {}
        }
    }
    names
}

/// The room of a file of `src/` and how many modules deep it is: `src/a/b/c.rs` is in room `a`, three deep.
fn module(file: &Path) -> (String, usize) {
    let path = file.strip_prefix(root().join("src")).unwrap().with_extension("");
    let mut parts: Vec<&str> = path.iter().map(|part| part.to_str().unwrap()).collect();
    if parts.last() == Some(&"mod") {
        parts.pop();
    }
    (parts[0].to_string(), parts.len())
}

/// What `text`, the file at `place` in room `from`, `depth` modules deep, imports of other rooms.
fn imports_of(code: &[String], from: &str, depth: usize, place: &str, rooms: &BTreeSet<String>) -> Vec<Import> {
    let text = code.join("\n");
    let up = "super::".repeat(depth);
    let prefixes = ["crate::", up.as_str()];
    let mut imports = Vec::new();
    for prefix in prefixes {
        for (at, _) in text.match_indices(prefix) {
            // Part of a longer word or path: `othercrate::`, or one `super::` of more.
            if text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
                continue;
            }
            let line = text[..at].matches('\n').count() + 1;
            for to in first_names(&text[at + prefix.len()..]) {
                if to != from && rooms.contains(&to) {
                    imports.push(Import { from: from.to_string(), to, place: format!("{place}:{line}") });
                }
            }
        }
    }
    imports
}

/// The rooms of `src/`: what `lib.rs` declares.
fn rooms() -> BTreeSet<String> {
    let text = read(&root().join("src/lib.rs"));
    let names = text.lines().filter_map(|line| line.trim_start_matches("pub ").strip_prefix("mod ")?.strip_suffix(';'));
    names.map(str::to_string).collect()
}

fn imports(rooms: &BTreeSet<String>) -> Vec<Import> {
    let files = sources(&root().join("src"));
    let mut of_tests = BTreeSet::new();
    let mut codes = Vec::new();
    for file in &files {
        let (code, test_modules) = production(&read(file));
        // `mod tests;` in `a.rs` is `a/tests.rs`, in `a/mod.rs` and `lib.rs` it is their neighbour.
        let stem = file.file_stem().unwrap();
        let home = if stem == "mod" || stem == "lib" { file.parent().unwrap().into() } else { file.with_extension("") };
        of_tests.extend(test_modules.iter().map(|module| home.join(module).with_extension("rs")));
        codes.push((file, code));
    }
    let mut all = Vec::new();
    for (file, code) in codes {
        let (room, depth) = module(file);
        if of_tests.contains(file) || !rooms.contains(&room) {
            continue;
        }
        let place = file.strip_prefix(root()).unwrap().display().to_string();
        all.extend(imports_of(&code, &room, depth, &place, rooms));
    }
    all
}

/// Names between backticks.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

/// Pairs of rooms of which the first never imports the second: the rows of the page's table.
fn never(page: &str, rooms: &BTreeSet<String>) -> BTreeSet<(String, String)> {
    let rows = page.lines().skip_while(|line| !line.starts_with("| module | never imports |")).skip(2);
    let mut pairs = BTreeSet::new();
    for line in rows.take_while(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [who, whom, why] = cells[..] else { panic!("a row of three cells expected: {line}") };
        assert!(!why.is_empty(), "a reason expected: {line}");
        let names = |cell: &str| -> Vec<String> {
            if cell == "any other module" {
                return rooms.iter().filter(|room| *room != "error").cloned().collect();
            }
            let names = quoted(cell);
            assert!(!names.is_empty(), "names expected: {line}");
            for name in &names {
                assert!(rooms.contains(name), "`{name}` is no module of src/lib.rs: {line}");
            }
            names
        };
        let whom = names(whom);
        pairs.extend(names(who).iter().flat_map(|who| whom.iter().map(|whom| (who.clone(), whom.clone()))));
    }
    pairs.into_iter().filter(|(who, whom)| who != whom).collect()
}

fn page() -> String {
    read(&root().join("docs/architecture.md"))
}

#[test]
fn no_room_imports_what_the_page_says_it_never_does() {
    let rooms = rooms();
    let never = never(&page(), &rooms);
    assert!(never.len() > 100, "rules are found at all: {}", never.len());
    let imports = imports(&rooms);
    assert!(imports.len() > 100, "imports are found at all: {}", imports.len());
    let broken: Vec<String> = imports
        .into_iter()
        .map(|Import { from, to, place }| ((from, to), place))
        .filter(|(pair, _)| never.contains(pair))
        .map(|((from, to), place)| format!("{place}: `{from}` never imports `{to}` (docs/architecture.md)"))
        .collect();
    assert!(broken.is_empty(), "\n{}", broken.join("\n"));
}

#[test]
fn imports_go_in_no_circle() {
    let rooms = rooms();
    let mut below: BTreeMap<String, BTreeSet<String>> = rooms.iter().map(|room| (room.clone(), [].into())).collect();
    for import in imports(&rooms) {
        below.get_mut(&import.from).unwrap().insert(import.to);
    }
    // Rooms whose imports are all gone go, until none is left.
    while let Some(room) = below.iter().find(|(_, imports)| imports.is_empty()).map(|(room, _)| room.clone()) {
        below.remove(&room);
        below.values_mut().for_each(|imports| {
            imports.remove(&room);
        });
    }
    assert!(below.is_empty(), "rooms that import each other in a circle, or import one that does: {below:?}");
}

/// Whether a page's words are the path of a source.
fn is_source(path: &str) -> bool {
    ["src/", "crates/", "tests/"].iter().any(|folder| path.starts_with(folder)) && path.ends_with(".rs")
}

#[test]
fn files_that_pages_name_exist() {
    for page in ["docs/architecture.md", "docs/src/how-it-works.md", "docs/src/formats.md", "docs/src/library.md"] {
        let text = read(&root().join(page));
        let mut named = 0;
        for (number, line) in text.lines().enumerate() {
            for path in quoted(line).iter().filter(|path| is_source(path)) {
                assert!(root().join(path).is_file(), "{page}:{}: `{path}` is not there", number + 1);
                named += 1;
            }
        }
        assert!(named > 0, "{page} names files");
    }
}
