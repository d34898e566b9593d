//! Turns the numbers by which the library names the fields of a list into the files that users gave.

use std::path::PathBuf;

use crate::Error;

/// The error of a merge of `files`, with files in place of `field 1`, `field 2`, … The first of them that keeps no sums
/// is `bare`.
pub fn in_files(error: Error, files: &[PathBuf], bare: Option<usize>) -> Error {
    let Error::Setting { what, expected, found } = error else { return error };
    let name = |number: &str| {
        let index = number.parse::<usize>().ok()?.checked_sub(1)?;
        files.get(index).map(|path| path.display().to_string())
    };
    // Only where the library puts numbers: what stands between may quote a file with such a name.
    let named = |text: &str, before: &str| {
        let (rest, number) = text.rsplit_once(before)?;
        Some(format!("{rest}{}{}", before.trim_end_matches("field "), name(number)?))
    };
    let both = |text: &str| {
        let (first, rest) = text.strip_prefix("fields ")?.split_once(" and ")?;
        let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        let (second, rest) = rest.split_at(end);
        Some(format!("{} and {}{rest}", name(first)?, name(second)?))
    };
    let without_sums = |what: &str| {
        let path = files.get(bare?)?.display();
        (what == "kept sums").then(|| format!("{path}, which does not"))
    };
    Error::Setting {
        found: both(&found).or_else(|| without_sums(&what)).unwrap_or(found),
        what: named(&what, " of field ").unwrap_or(what),
        expected: named(&expected, ", as in field ").unwrap_or(expected),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_become_files_and_quotations_stay() {
        let files = ["a.oct", "my parts/b.oct"].map(PathBuf::from);
        let said = |what, expected, found| in_files(Error::setting(what, expected, found), &files, Some(1)).to_string();
        assert_eq!(
            said("model and cameras of field 2", "of field 2.npz, as in field 1", "of field 1"),
            "model and cameras of my parts/b.oct: expected of field 2.npz, as in a.oct, found of field 1"
        );
        assert_eq!(
            said("fields to merge", "others", "fields 1 and 2, which may have rays in common"),
            "fields to merge: expected others, found a.oct and my parts/b.oct, which may have rays in common"
        );
        assert_eq!(
            said("kept sums", "fields that keep their sums", "one that does not"),
            "kept sums: expected fields that keep their sums, found my parts/b.oct, which does not"
        );
        assert_eq!(said("fields to merge", "two or more", "one"), "fields to merge: expected two or more, found one");
        assert_eq!(
            said("lambda of field 3", "a", "fields 0 and 1"),
            "lambda of field 3: expected a, found fields 0 and 1"
        );
    }
}
