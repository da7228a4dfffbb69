//! Tables as text for the terminal, as Markdown, and as data of the report page.

use serde::Serialize;

/// A row of a table: its heading and its values.
pub type TableRow = (String, Vec<String>);

/// A table with one or more lines of headings. A heading spans the empty headings on its right,
/// except in the first column.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Table {
    /// Caption; may be empty.
    pub caption: String,
    /// Lines of headings, each with as many entries as a row including its heading.
    pub head: Vec<Vec<String>>,
    /// The rows.
    pub rows: Vec<TableRow>,
}

impl Table {
    /// A table with one line of column headings.
    pub fn of_columns(names: &[String], rows: Vec<TableRow>) -> Self {
        let head = std::iter::once(String::new()).chain(names.iter().cloned()).collect();
        Self { caption: String::new(), head: vec![head], rows }
    }

    /// All lines, headings first.
    fn lines(&self) -> Vec<Vec<&str>> {
        let head = self.head.iter().map(|line| line.iter().map(String::as_str).collect());
        let rows = self.rows.iter().map(|(name, values)| {
            std::iter::once(name.as_str()).chain(values.iter().map(String::as_str)).collect()
        });
        head.chain(rows).collect()
    }

    /// The table as text with aligned columns: row headings on the left, values on the right.
    pub fn to_text(&self) -> String {
        const GAP: usize = 2;
        let lines = self.lines();
        let count = lines.iter().map(Vec::len).max().unwrap_or(0);
        let mut widths = vec![0; count];
        for (index, line) in lines.iter().enumerate() {
            for (column, text) in line.iter().enumerate() {
                let is_wide = index < self.head.len() && span(line, column) > 1;
                if !is_wide {
                    widths[column] = widths[column].max(text.chars().count());
                }
            }
        }
        // A heading that is wider than the columns it spans widens the last of them.
        for line in &lines[..self.head.len()] {
            for column in 0..line.len() {
                let span = span(line, column);
                let has: usize =
                    widths[column..column + span].iter().sum::<usize>() + GAP * (span - 1);
                widths[column + span - 1] += line[column].chars().count().saturating_sub(has);
            }
        }
        let mut text = String::new();
        for (index, line) in lines.iter().enumerate() {
            let mut out = String::new();
            let mut column = 0;
            while column < line.len() {
                let span = if index < self.head.len() { span(line, column) } else { 1 };
                let width = widths[column..column + span].iter().sum::<usize>() + GAP * (span - 1);
                if column == 0 {
                    out += &format!("{:<width$}", line[column]);
                } else {
                    out += &format!("{:GAP$}{:>width$}", "", line[column]);
                }
                column += span;
            }
            text += out.trim_end();
            text.push('\n');
        }
        if self.caption.is_empty() { text } else { format!("{}\n\n{text}", self.caption) }
    }

    /// The table as Markdown: the first line of headings, a rule, and all other lines.
    pub fn to_markdown(&self) -> String {
        let lines = self.lines();
        let mut text =
            if self.caption.is_empty() { String::new() } else { format!("{}\n\n", self.caption) };
        for (index, line) in lines.iter().enumerate() {
            text += &format!("| {} |\n", line.join(" | "));
            if index == 0 {
                text += &format!("|{}\n", "---|".repeat(line.len()));
            }
        }
        text
    }
}

/// Number of columns that a heading spans.
fn span(line: &[&str], column: usize) -> usize {
    if column == 0 {
        return 1;
    }
    1 + line[column + 1..].iter().take_while(|text| text.is_empty()).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let words =
            |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        Table {
            caption: "Table 3. Errors.".to_owned(),
            head: vec![
                words(&["Camera", "Mean [m]", "", "Std [m]", ""]),
                words(&["", "Ours", "Exact", "Ours", "Exact"]),
            ],
            rows: vec![
                ("Front".to_owned(), words(&["1.253", "0.1", "2.049", "0.2"])),
                ("Rear".to_owned(), words(&["1.252", "-", "2.052", "-"])),
            ],
        }
    }

    #[test]
    fn headings_are_aligned_with_their_columns() {
        let expected = "\
Table 3. Errors.

Camera      Mean [m]       Std [m]
         Ours  Exact   Ours  Exact
Front   1.253    0.1  2.049    0.2
Rear    1.252      -  2.052      -
";
        assert_eq!(table().to_text(), expected);
    }

    #[test]
    fn markdown_has_a_rule_after_the_first_line() {
        let expected = "\
Table 3. Errors.

| Camera | Mean [m] |  | Std [m] |  |
|---|---|---|---|---|
|  | Ours | Exact | Ours | Exact |
| Front | 1.253 | 0.1 | 2.049 | 0.2 |
| Rear | 1.252 | - | 2.052 | - |
";
        assert_eq!(table().to_markdown(), expected);
    }

    #[test]
    fn a_wide_heading_widens_its_last_column() {
        let mut table = table();
        table.caption.clear();
        table.head[0][1] = "Mean absolute distance [m]".to_owned();
        let text = table.to_text();
        let lengths: Vec<usize> = text.lines().map(str::len).collect();
        assert!(lengths.iter().all(|length| *length == lengths[0]), "{text}");
    }
}
