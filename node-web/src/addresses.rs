//! Addresses that the router serves and the check of rights knows.

/// Addresses of the page that are of no telescope; each is the same document, whose script reads the address.
pub const NETWORK_PAGES: &[&str] =
    &["/", "/alerts", "/weather", "/frames", "/report", "/log", "/nodes", "/audit", "/settings", "/wall"];
