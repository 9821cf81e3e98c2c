//! The page and its assets, built into the program.

use axum::Extension;
use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use users::Principal;

use crate::problem::Problem;

/// The type of a page.
pub const HTML: &str = "text/html; charset=utf-8";

/// The assets by their path below `/assets/`: what the browser loads, each built into the program.
macro_rules! assets {
    ($($path:literal)*) => {
        &[$(($path, include_bytes!(concat!("../assets/", $path)))),*]
    };
}

/// Path and content of each asset.
const ASSETS: &[(&str, &[u8])] = assets! {
    "activity.js" "api.js" "app.js" "astro.js" "cameback.js" "changes.js" "chart.js" "close.js" "corrections.js" "devicelist.js"
    "devices.js" "draft.js" "draftline.js" "editor.js" "elapsed.js" "favicon-critical.svg" "favicon-high.svg" "favicon-medium.svg" "favicon.svg"
    "forecast.js" "form.js" "format.js" "history.js"
    "image.js" "inputs.js" "lib.js" "live.css" "login.js" "look.js" "manifest.webmanifest" "night.js" "numbers.js"
    "pages.js" "parts.js" "picture.js" "pixels.js" "plane.js" "push.js" "route.js" "row.js" "rowtext.js"
    "service-worker.js" "shell.js" "site.js" "sky.js" "starmesh.css" "store.js" "templates.js" "theme.js" "timeview.js"
    "user.js" "viewer.js" "webcams.js" "fonts/LICENSE-Inter.txt" "fonts/LICENSE-JetBrainsMono.txt"
    "fonts/inter-var.woff2" "fonts/jetbrains-mono.woff2" "pages/alerts.js" "pages/audit.js" "pages/controls.js"
    "pages/device.js" "pages/focus.js" "pages/frame.js" "pages/frames.js" "pages/guiding.js" "pages/lightcurve.js"
    "pages/log.js" "pages/network.js" "pages/nodes.js" "pages/report.js" "pages/schedule.js" "pages/settings.js"
    "pages/telescope.js" "pages/users.js" "pages/wall.js" "pages/weather.js" "vendor/LICENSES.txt" "vendor/hooks.js"
    "vendor/htm.js" "vendor/preact.js" "vendor/signals-core.js" "vendor/signals.js" "vendor/uplot.js"
};
/// What lets the page open without this server.
const SERVICE_WORKER: &str = "service-worker.js";
const FAVICON: &[u8] = include_bytes!("../assets/favicon.svg");
const INDEX: &str = include_str!("../assets/index.html");
const LOGIN: &str = include_str!("../assets/login.html");

/// The type of an asset, by its name's end.
fn kind_of(path: &str) -> &'static str {
    match path.rsplit_once('.').map_or("", |(_, end)| end) {
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "woff2" => "font/woff2",
        "webmanifest" => "application/manifest+json",
        _ => "text/plain; charset=utf-8",
    }
}

/// The one page, which reads its own address to know what to show; for somebody without any right, the login page.
pub async fn index(Extension(principal): Extension<Principal>, headers: HeaderMap) -> Response {
    match principal.right_anywhere() {
        // Stored by a browser from which somebody logs out, it is asked for again.
        Some(_) => ([(header::VARY, "Cookie")], served(&headers, HTML, INDEX.as_bytes())).into_response(),
        None => login(),
    }
}

/// The login page, in the place of a page that somebody without any right asked for.
pub fn login() -> Response {
    let named = [
        (header::CONTENT_TYPE, HTML),
        (header::CACHE_CONTROL, "no-store"),
        (header::WWW_AUTHENTICATE, "Bearer realm=\"starmesh\""),
    ];
    (StatusCode::UNAUTHORIZED, named, LOGIN).into_response()
}

/// One asset.
pub async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    match ASSETS.iter().find(|(path, _)| *path == name) {
        // It looks after every address of the page, not only those below its own.
        Some((path, content)) if *path == SERVICE_WORKER => {
            ([("service-worker-allowed", "/")], served(&headers, kind_of(path), content)).into_response()
        }
        Some((path, content)) => served(&headers, kind_of(path), content),
        None => Problem::not_found(format!("There is no asset {name}.")).into_response(),
    }
}

/// For browsers that ask without reading the page.
pub async fn favicon(headers: HeaderMap) -> Response {
    served(&headers, kind_of("favicon.svg"), FAVICON)
}

/// Revalidated each time: after an update of the node no browser mixes old scripts with new ones.
fn served(headers: &HeaderMap, kind: &'static str, content: &'static [u8]) -> Response {
    let tag = format!("\"{:016x}\"", fnv(content));
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

    fn scripts() -> impl Iterator<Item = (&'static str, &'static str)> {
        let own = ASSETS.iter().filter(|(path, _)| path.ends_with(".js"));
        own.map(|(path, content)| (*path, std::str::from_utf8(content).unwrap()))
    }

    fn is_served(path: &str) -> bool {
        ASSETS.iter().any(|(asset, _)| *asset == path)
    }

    #[test]
    fn the_page_names_only_assets_that_are_served_and_runs_nothing_inline() {
        for page in [INDEX, LOGIN] {
            for part in page.split("\"/assets/").skip(1) {
                let path = part.split('"').next().unwrap();
                assert!(is_served(path), "{path}");
            }
            assert!(!page.contains("style=") && !page.contains("<style") && !page.contains(" onclick"));
            let loaded = page.matches("<script src").count() + page.matches("<script type=\"module\" src").count();
            assert_eq!(page.matches("<script").count(), loaded);
        }
    }

    /// What a script names after `word` and a quotation mark: files of ours.
    fn named_after(asset: &str, content: &str, word: &str) -> Vec<String> {
        let folder = asset.rsplit_once('/').map_or("", |(folder, _)| folder);
        let path = |part: &str| {
            let name = part.split('"').next().unwrap();
            match (name.strip_prefix("./"), name.strip_prefix("../")) {
                (Some(beside), _) if folder.is_empty() => beside.to_owned(),
                (Some(beside), _) => format!("{folder}/{beside}"),
                (None, Some(above)) if !folder.contains('/') => above.to_owned(),
                _ => panic!("{asset} imports {name}"),
            }
        };
        content.split(word).skip(1).map(path).collect()
    }

    /// What comes with a script.
    fn imports(asset: &str, content: &str) -> Vec<String> {
        named_after(asset, content, if asset.starts_with("vendor/") { "from\"" } else { "from \"" })
    }

    #[test]
    fn scripts_import_only_each_other_and_nothing_comes_from_elsewhere() {
        for (asset, content) in scripts() {
            for path in [imports(asset, content), named_after(asset, content, "import(\"")].concat() {
                assert!(is_served(&path), "{asset} imports {path}");
            }
            if !asset.starts_with("vendor/") {
                let elsewhere = content.replace("http://www.w3.org/", "");
                assert!(!elsewhere.contains("https://") && !elsewhere.contains("http://"), "{asset}");
                assert!(!content.contains("innerHTML"), "{asset}: text from outside never becomes markup");
            }
        }
    }

    #[test]
    fn every_file_in_the_folder_of_assets_is_served() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/assets");
        let mut folders = vec![root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(&root).unwrap().to_str().unwrap().to_owned();
                    assert!(name.ends_with(".html") || is_served(&name), "{name} is missing in ASSETS");
                }
            }
        }
    }

    #[test]
    fn the_first_load_is_small() {
        // What comes before any page, and the largest page with what it needs; in bytes, not compressed.
        let scripts: std::collections::BTreeMap<_, _> = scripts().collect();
        let with_imports = |first: &[String]| {
            let (mut ahead, mut all) = (first.to_vec(), std::collections::BTreeSet::new());
            while let Some(asset) = ahead.pop() {
                if all.insert(asset.clone()) {
                    ahead.extend(imports(&asset, scripts[asset.as_str()]));
                }
            }
            all.iter().map(|asset| scripts[asset.as_str()].len()).sum::<usize>()
        };
        let first = ["app.js".to_owned(), "theme.js".to_owned()];
        let pages = named_after("pages.js", scripts["pages.js"], "import(\"");
        assert!(pages.len() > 20);
        for page in pages {
            let all = with_imports(&[&first[..], std::slice::from_ref(&page)].concat());
            assert!(all < 200_000, "{page}: {all}");
        }
    }
}
