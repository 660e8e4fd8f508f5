//! The report of an experiment as HTML. It is Markdown with headings, paragraphs, tables, blocks of
//! code, code in lines, pictures and links.

use super::page::{Report, escaped};
use std::fmt::Write;

/// Add a text to the page. `picture` returns the bytes of a PNG file in the folder of the text.
pub(super) fn add(report: &mut Report, text: &str, picture: &dyn Fn(&str) -> Option<Vec<u8>>) {
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        if line.starts_with("# ") || line.trim().is_empty() {
            // The page has a title.
        } else if let Some(heading) = line.strip_prefix("## ") {
            report.heading(heading);
        } else if line.starts_with("```") {
            let code: Vec<_> = lines.by_ref().take_while(|line| !line.starts_with("```")).collect();
            report.html(&format!("<pre>{}</pre>", escaped(&code.join("\n"))));
        } else if let Some((alternative, path)) = whole_picture(line) {
            match picture(path) {
                Some(png) => report.picture(&png, alternative),
                None => report.note(&format!("{path} is missing.")),
            }
        } else if line.starts_with('|') {
            let mut rows = vec![cells(line)];
            while let Some(row) = lines.next_if(|line| line.starts_with('|')) {
                rows.push(cells(row));
            }
            report.html(&table(&rows));
        } else {
            let mut paragraph = line.to_owned();
            while let Some(more) = lines.next_if(|line| !line.trim().is_empty()) {
                write!(paragraph, " {more}").expect("writing to a string cannot fail");
            }
            report.html(&format!("<p>{}</p>", inline(&paragraph)));
        }
    }
}

/// The text and path of a line that consists of a picture.
fn whole_picture(line: &str) -> Option<(&str, &str)> {
    line.strip_prefix("![")?.strip_suffix(')')?.split_once("](")
}

fn cells(line: &str) -> Vec<&str> {
    line.trim().trim_matches('|').split('|').map(str::trim).collect()
}

/// A table whose second row separates the head.
fn table(rows: &[Vec<&str>]) -> String {
    let row = |tag: &str, cells: &[&str]| -> String {
        let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", inline(cell)));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    let head = row("th", &rows[0]);
    let body: String = rows.iter().skip(2).map(|cells| row("td", cells)).collect();
    format!("<table>\n<thead>{head}</thead>\n<tbody>\n{body}</tbody>\n</table>")
}

/// Text with code; of links, which lead to other files, the text remains.
fn inline(text: &str) -> String {
    let mut html = String::new();
    for (number, part) in text.split('`').enumerate() {
        if number % 2 == 1 {
            write!(html, "<code>{}</code>", escaped(part))
                .expect("writing to a string cannot fail");
            continue;
        }
        let mut rest = part;
        while let Some((before, text, after)) = link(rest) {
            html += &escaped(before);
            html += &escaped(text);
            rest = after;
        }
        html += &escaped(rest);
    }
    html
}

/// The first link: what is before it, its text, and what is after it.
fn link(text: &str) -> Option<(&str, &str, &str)> {
    let (before, rest) = text.split_once('[')?;
    let (name, rest) = rest.split_once("](")?;
    let (_, after) = rest.split_once(')')?;
    Some((before, name, after))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_kinds_of_lines() {
        assert_eq!(inline("a `b<c` [d](e.png), f & g"), "a <code>b&lt;c</code> d, f &amp; g");
        assert_eq!(
            whole_picture("![Errors](figures/errors.png)"),
            Some(("Errors", "figures/errors.png"))
        );
        assert_eq!(whole_picture("text ![Errors](figures/errors.png)"), None);
        let rows = ["| a | b |", "|---|---|", "| 1 ± 2 | - |"].map(cells);
        let html = table(&rows);
        assert!(html.contains("<thead><tr><th>a</th><th>b</th></tr>"), "{html}");
        assert!(html.contains("<tbody>\n<tr><td>1 ± 2</td><td>-</td></tr>\n</tbody>"), "{html}");
    }
}
