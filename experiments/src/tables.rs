//! Whole tables of reports that are too long for them: a CSV file each.

use std::path::Path;

use octobayes::{Error, Result};

use super::work::write_whole;

/// Rows of cells; the first row names the columns.
type Cells = Vec<Vec<String>>;

/// The tables of a block, which are in Markdown.
fn of(body: &str) -> Vec<Cells> {
    let mut tables: Vec<Cells> = Vec::new();
    let mut is_inside = false;
    for line in body.lines() {
        let Some(row) = line.trim().strip_prefix('|').and_then(|row| row.strip_suffix('|')) else {
            is_inside = false;
            continue;
        };
        let cells: Vec<String> = row.split(" | ").map(|cell| plain(cell.trim())).collect();
        if !is_inside {
            tables.push(Vec::new());
        }
        is_inside = true;
        let is_rule = cells.iter().all(|cell| !cell.is_empty() && cell.chars().all(|c| c == '-'));
        if let (false, Some(table)) = (is_rule, tables.last_mut()) {
            table.push(cells);
        }
    }
    tables
}

/// A cell without the commas of its numbers.
fn plain(cell: &str) -> String {
    let is_digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    let keep = |(i, c): (usize, char)| {
        let (before, behind) = (cell[..i].chars().next_back(), cell[i + c.len_utf8()..].chars().next());
        (c != ',' || !is_digit(before) || !is_digit(behind)).then_some(c)
    };
    cell.char_indices().filter_map(keep).collect()
}

/// Writes the tables of a block to `NAME.csv`, `NAME_2.csv` and so on in a folder.
///
/// # Errors
/// If a file cannot be written.
pub fn write(folder: &Path, name: &str, body: &str) -> Result<()> {
    for (number, table) in (1..).zip(of(body)) {
        let end = if number == 1 { String::new() } else { format!("_{number}") };
        let path = folder.join(format!("{}{end}.csv", name.replace('-', "_")));
        let mut csv = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
        let written = table.iter().try_for_each(|row| csv.write_record(row));
        let wrong = |e: String| Error::malformed(&path, "table", "cells that CSV can hold", e);
        written.map_err(|e| wrong(e.to_string()))?;
        write_whole(&path, &csv.into_inner().map_err(|e| wrong(e.to_string()))?)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_a_block_become_files() {
        let folder = tempfile::tempdir().unwrap();
        let body = "*stamp* words\n\n| a | b, c |\n| --- | --- |\n| 1,234,567 | x, y |\n|  | 2 ± 1 |\n\n\
                    more\n\n| d |\n| --- |\n| 5 |\n";
        write(folder.path(), "report_one-part", body).unwrap();
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert_eq!(read("report_one_part.csv"), "a,\"b, c\"\n1234567,\"x, y\"\n,2 ± 1\n");
        assert_eq!(read("report_one_part_2.csv"), "d\n5\n");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
