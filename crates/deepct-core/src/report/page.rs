//! The parts of a page and their assembly.

use super::exhibit::Exhibits;
use crate::encoding::base64;
use crate::error::Result;
use crate::files;
use std::fmt::Write;
use std::path::Path;

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("style.css");
const VIEWER: &str = include_str!("viewer.html");
const SCRIPT: &str = include_str!("viewer.js");

/// A page that is being composed.
#[derive(Debug)]
pub struct Report {
    title: String,
    body: String,
    exhibits: Exhibits,
}

impl Report {
    /// A page with a title only.
    pub(super) fn new(title: &str) -> Self {
        Self { title: title.into(), body: String::new(), exhibits: Exhibits::new() }
    }

    /// The volumes, which are shown where [`Report::viewer`] was called.
    pub(super) fn exhibits(&mut self) -> &mut Exhibits {
        &mut self.exhibits
    }

    /// Add HTML.
    pub(super) fn html(&mut self, html: &str) {
        self.body += html;
        self.body.push('\n');
    }

    /// Add a heading.
    pub(super) fn heading(&mut self, text: &str) {
        self.html(&format!("<h2>{}</h2>", escaped(text)));
    }

    /// Add a remark in small print.
    pub(super) fn note(&mut self, text: &str) {
        self.html(&format!("<p class=\"note\">{}</p>", escaped(text)));
    }

    /// Add a table with its head; nothing if it has no rows.
    pub(super) fn table(&mut self, head: &[&str], rows: &[Vec<String>]) {
        if rows.is_empty() {
            return;
        }
        let cells = |tag: &str, texts: &mut dyn Iterator<Item = &str>| -> String {
            texts.map(|text| format!("<{tag}>{}</{tag}>", escaped(text))).collect()
        };
        let mut html = String::from("<table>\n<thead><tr>");
        html += &cells("th", &mut head.iter().copied());
        html += "</tr></thead>\n<tbody>\n";
        for row in rows {
            let row = cells("td", &mut row.iter().map(String::as_str));
            writeln!(html, "<tr>{row}</tr>").expect("writing to a string cannot fail");
        }
        self.html(&(html + "</tbody>\n</table>"));
    }

    /// Add a PNG picture with a caption.
    pub(super) fn picture(&mut self, png: &[u8], caption: &str) {
        let caption = escaped(caption);
        self.html(&format!(
            "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\">\
             <figcaption>{caption}</figcaption></figure>",
            base64(png)
        ));
    }

    /// Add the view of the volumes; nothing if there are none.
    pub(super) fn viewer(&mut self) {
        if !self.exhibits.is_empty() {
            let html = VIEWER.replace("{{storage}}", &escaped(&self.exhibits.storage()));
            self.html(&html);
        }
    }

    /// The page as HTML.
    pub fn to_html(&self) -> String {
        let scripts = if self.exhibits.is_empty() {
            String::new()
        } else {
            let data = serde_json::to_string(&self.exhibits).expect("plain numbers and text");
            // A name in the data must not end the element.
            let data = data.replace('<', "\\u003c");
            format!(
                "<script type=\"application/json\" id=\"data\">{data}</script>\n\
                 <script>\n{SCRIPT}</script>\n"
            )
        };
        let title = escaped(&self.title);
        let parts = [
            ("title", title.as_str()),
            ("version", env!("CARGO_PKG_VERSION")),
            ("style", STYLE),
            ("body", &self.body),
            ("scripts", &scripts),
        ];
        // Each mark is replaced once and what takes its place is not searched for marks.
        let mut text = String::new();
        let mut rest = PAGE;
        while let Some((before, after)) = rest.split_once("{{") {
            text += before;
            let (name, after) = after.split_once("}}").expect("marks of the template are closed");
            let part = parts.iter().find(|(mark, _)| *mark == name);
            text += part.expect("marks of the template are known").1;
            rest = after;
        }
        text + rest
    }

    /// Write the page, first under a temporary name, so that an aborted run leaves no incomplete
    /// file.
    ///
    /// # Errors
    /// A folder that does not exist or cannot be written to.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        files::write(path.as_ref(), self.to_html())
    }
}

/// Text as HTML.
pub(super) fn escaped(text: &str) -> String {
    let mut html = String::new();
    for letter in text.chars() {
        match letter {
            '&' => html += "&amp;",
            '<' => html += "&lt;",
            '>' => html += "&gt;",
            '"' => html += "&quot;",
            other => html.push(other),
        }
    }
    html
}

#[cfg(test)]
mod tests {
    use super::super::exhibit::Exhibit;
    use super::*;
    use crate::grid::{Grid, Volume};
    use crate::math::DVec3;
    use crate::scene::Sun;

    #[test]
    fn names_are_text() {
        let mut report = Report::new("</title><script>alert(1)</script> {{body}}");
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 1]).unwrap();
        let name = "</script><script>alert(2)</script>";
        let volume = Volume::constant(grid, 1.0);
        let exhibit = Exhibit::new(name, &grid, 1).with("extinction", &volume).unwrap();
        let index = report.exhibits().add(exhibit);
        report.exhibits().show(None, index, &Sun::default(), name);
        report.table(&[name], &[vec![name.into()]]);
        report.picture(b"", name);
        report.viewer();
        let text = report.to_html();
        assert!(!text.contains("<script>alert"), "{text}");
        assert_eq!(text.matches("<script").count(), 2);
        assert!(text.contains("&lt;/script&gt; {{body}}</h1>"));
        assert!(!text.replace("{{body}}", "").contains("{{"));
    }

    #[test]
    fn the_page_refers_to_nothing_else() {
        let mut report = Report::new("title");
        report.picture(b"png", "picture");
        let text = report.to_html() + VIEWER + SCRIPT + STYLE;
        for outside in ["http:", "https:", "//cdn", "url(", "import ", "src=\"/", "fetch("] {
            assert!(!text.contains(outside), "{outside}");
        }
        assert!(!report.to_html().contains("<script"));
    }
}
