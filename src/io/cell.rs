//! Texts in CSV.

/// A text as a cell of CSV. One that a spreadsheet would take for a formula gets a `'` in front.
///
/// Names of frames come from files of others, and a cell that starts with `=`, `+`, `-`, `@`, a tab or the end of a
/// line may be run when the table is opened. Numbers are no texts: they stay as they are.
#[must_use]
pub fn cell(text: String) -> String {
    if text.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']) { format!("'{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_become_texts_and_texts_stay() {
        for text in ["=1+1", "+1", "-1", "@sum", "\t=1", "\r=1", "\n=1"] {
            assert_eq!(cell(text.into()), format!("'{text}"));
        }
        for text in ["", "r_0", "images/=1.png", "'=1", " =1"] {
            assert_eq!(cell(text.into()), text);
        }
    }
}
