//! A picture as a part of a page instead of a file of its own.
//!
//! Several pictures in one page share its names, so each gets a prefix of its own. What only files need is left out. Colours stay
//! attributes, which a style sheet may replace.

/// The namespace, which a page does not need and a reader may take for an address.
const NAMESPACE: &str = " xmlns=\"http://www.w3.org/2000/svg\"";

/// An SVG document of these figures as an element of a page; `prefix` is letters, digits and hyphens, and different for each picture
/// of the page.
///
/// Text in a picture is escaped and so holds no quotation mark: what is replaced here is always the figure's own markup.
pub fn inline(svg: &str, prefix: &str) -> String {
    svg.replacen(NAMESPACE, "", 1)
        .replace(" id=\"", &format!(" id=\"{prefix}-"))
        .replace("\"url(#", &format!("\"url(#{prefix}-"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::session::render_errors;

    #[test]
    fn names_are_the_pictures_own_and_no_text_is_changed() {
        let svg = inline(&render_errors(" id=\"x\" \"url(#y)\"", &[]), "run-1");
        assert!(!svg.contains("http"), "{svg}");
        assert!(svg.contains("<clipPath id=\"run-1-clip1\">") && svg.contains("\"url(#run-1-clip1)\""));
        assert!(svg.contains("<title> id=&quot;x&quot; &quot;url(#y)&quot;</title>"), "{svg}");
        let ids = svg.matches(" id=\"").count();
        assert_eq!(svg.matches(" id=\"run-1-").count(), ids);
    }
}
