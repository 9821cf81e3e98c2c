//! Addresses of the page; each is the same document, whose script reads the address.

/// Those that are of no telescope.
pub const NETWORK_PAGES: &[&str] =
    &["/", "/alerts", "/weather", "/frames", "/report", "/log", "/nodes", "/audit", "/settings", "/wall"];

/// Is it one of the page, which is the login page for nobody?
pub fn is_page(path: &str) -> bool {
    NETWORK_PAGES.contains(&path) || path.starts_with("/t/")
}

#[cfg(test)]
mod tests {
    use super::is_page;

    #[test]
    fn every_page_is_known_as_one_and_nothing_else_is() {
        for page in ["/", "/log", "/settings", "/t/paranal/io", "/t/paranal/io/frames/x"] {
            assert!(is_page(page), "{page}");
        }
        for other in ["/lite", "/api/v1/network", "/assets/app.js", "/logs", "/metrics"] {
            assert!(!is_page(other), "{other}");
        }
    }
}
