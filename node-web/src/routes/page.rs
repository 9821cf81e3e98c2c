//! The page and its assets, built into the program.

use axum::Extension;
use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use users::Principal;

use crate::problem::Problem;

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Name, type and content of each asset.
const ASSETS: &[(&str, &str, &str)] = &[
    ("style.css", "text/css; charset=utf-8", include_str!("../assets/style.css")),
    ("favicon.svg", "image/svg+xml", FAVICON),
    ("theme.js", SCRIPT, include_str!("../assets/theme.js")),
    ("login.js", SCRIPT, include_str!("../assets/login.js")),
    ("user.js", SCRIPT, include_str!("../assets/user.js")),
    ("app.js", SCRIPT, include_str!("../assets/app.js")),
    ("link.js", SCRIPT, include_str!("../assets/link.js")),
    ("dom.js", SCRIPT, include_str!("../assets/dom.js")),
    ("format.js", SCRIPT, include_str!("../assets/format.js")),
    ("overview.js", SCRIPT, include_str!("../assets/overview.js")),
    ("telescope.js", SCRIPT, include_str!("../assets/telescope.js")),
    ("devices.js", SCRIPT, include_str!("../assets/devices.js")),
];
const FAVICON: &str = include_str!("../assets/favicon.svg");
const INDEX: &str = include_str!("../assets/index.html");
const LOGIN: &str = include_str!("../assets/login.html");

/// The one page, which reads its own address to know what to show; for somebody without any right, the login page.
pub async fn index(Extension(principal): Extension<Principal>, headers: HeaderMap) -> Response {
    match principal.right_anywhere() {
        // Stored by a browser from which somebody logs out, it is asked for again.
        Some(_) => ([(header::VARY, "Cookie")], served(&headers, HTML, INDEX)).into_response(),
        None => {
            let named = [
                (header::CONTENT_TYPE, HTML),
                (header::CACHE_CONTROL, "no-store"),
                (header::WWW_AUTHENTICATE, "Bearer realm=\"starmesh\""),
            ];
            (StatusCode::UNAUTHORIZED, named, LOGIN).into_response()
        }
    }
}

/// One asset.
pub async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    match ASSETS.iter().find(|(asset, ..)| *asset == name) {
        Some((_, kind, content)) => served(&headers, kind, content),
        None => Problem::not_found(format!("There is no asset {name}.")).into_response(),
    }
}

/// For browsers that ask without reading the page.
pub async fn favicon(headers: HeaderMap) -> Response {
    served(&headers, "image/svg+xml", FAVICON)
}

/// Revalidated each time: after an update of the node no browser mixes old scripts with new ones.
fn served(headers: &HeaderMap, kind: &'static str, content: &'static str) -> Response {
    let tag = format!("\"{:016x}\"", fnv(content.as_bytes()));
    let known = headers.get(header::IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let named = [(header::ETAG, tag), (header::CACHE_CONTROL, "no-cache".to_owned())];
    if known {
        return (StatusCode::NOT_MODIFIED, named).into_response();
    }
    (named, [(header::CONTENT_TYPE, kind)], content).into_response()
}

/// FNV-1a: identifies a content, protects nothing.
const fn fnv(bytes: &[u8]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325;
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0100_0000_01b3);
        i += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_names_only_assets_that_are_served_and_runs_nothing_inline() {
        for page in [INDEX, LOGIN] {
            for part in page.split("/assets/").skip(1) {
                let name: String = part.chars().take_while(|c| c.is_alphanumeric() || matches!(c, '.' | '-')).collect();
                assert!(ASSETS.iter().any(|(asset, ..)| *asset == name), "{name}");
            }
            assert!(!page.contains("style=") && !page.contains("<style") && !page.contains(" onclick"));
            let loaded = page.matches("<script src").count() + page.matches("<script type=\"module\" src").count();
            assert_eq!(page.matches("<script").count(), loaded);
        }
    }

    #[test]
    fn scripts_import_only_each_other_and_nothing_comes_from_elsewhere() {
        for (asset, kind, content) in ASSETS {
            if *kind == SCRIPT {
                for part in content.split("from \"").skip(1) {
                    let name = part.split('"').next().unwrap();
                    let name = name.strip_prefix("./").unwrap_or_else(|| panic!("{asset} imports {name}"));
                    assert!(ASSETS.iter().any(|(asset, ..)| *asset == name), "{asset} imports {name}");
                }
            }
            let elsewhere = content.replace("http://www.w3.org/", "");
            assert!(!elsewhere.contains("https://") && !elsewhere.contains("http://"), "{asset}");
        }
    }

    #[test]
    fn the_whole_page_is_small() {
        let scripts: usize = ASSETS.iter().map(|(_, _, content)| content.len()).sum();
        assert!(scripts + INDEX.len() < 200_000);
    }
}
