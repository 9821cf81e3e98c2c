//! Finds the predecessor's files: in its asset folder, or side by side in any folder.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};

use super::entry::{Entry, Notes};

/// The files of one observatory of the predecessor.
#[derive(Debug, PartialEq)]
pub struct PredecessorFiles {
    /// Name of the observatory.
    pub name: String,
    /// `NAME_config.yml`.
    pub config: PathBuf,
    /// `NAME_fits_header_config.csv`.
    pub header: Option<PathBuf>,
    /// `NAME.jsonl`.
    pub schedule: Option<PathBuf>,
    /// The star catalogue that `astra_config.yml` names, if that lies there.
    pub catalogue: Option<PathBuf>,
    /// The star catalogue that it names and that is not there.
    pub lost_catalogue: Option<PathBuf>,
    /// Classes of the site's own, in Python.
    pub classes: Vec<PathBuf>,
}

const CONFIG: &str = "_config.yml";
/// The predecessor's own file, in `~/.astra` unless it was configured otherwise.
const BASE: &str = "astra_config.yml";
/// The class that the predecessor installs for every site.
const TEMPLATE: &str = "observatory_subclass.py";

/// Finds the files under `folder`, or in the asset folder that `astra_config.yml` in it names; `name` chooses where
/// there are several observatories, or else `astra_config.yml` does, also the one in `home` if it names this folder.
///
/// # Errors
/// When there is none, or several and no name.
pub fn find(folder: &Path, name: Option<&str>, home: Option<&Path>) -> anyhow::Result<PredecessorFiles> {
    ensure!(folder.is_dir(), "{} is no folder; name the one with the site's files of Astra", folder.display());
    let here = Base::read(&folder.join(BASE), home);
    let elsewhere = home.map(|home| home.join(".astra").join(BASE)).and_then(|file| Base::read(&file, home));
    let same = |base: &Base| base.assets.as_deref().is_some_and(|assets| is_same(assets, folder));
    // A copy of an asset folder may contain a file that still names the old place.
    let leads = |assets: &PathBuf| assets.is_dir() && !folder.join("observatory_config").is_dir();
    let named = here.as_ref().and_then(|base| base.assets.clone()).filter(leads);
    let base = here.or_else(|| elsewhere.filter(same)).unwrap_or_default();
    let folder = named.as_deref().unwrap_or(folder);
    let places = [folder.join("observatory_config"), folder.to_owned()];
    let mut configs: Vec<(String, PathBuf)> = Vec::new();
    for place in places.iter().filter(|place| place.is_dir()) {
        for entry in std::fs::read_dir(place).with_context(|| format!("cannot read {}", place.display()))? {
            let path = entry?.path();
            let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if let Some(known) = file.strip_suffix(CONFIG)
                && known != "astra"
            {
                configs.push((known.to_owned(), path));
            }
        }
    }
    configs.sort();
    let names: Vec<&str> = configs.iter().map(|(known, _)| known.as_str()).collect();
    let usual = base.name.as_deref().filter(|usual| names.contains(usual));
    let chosen = match (name.or(usual), configs.as_slice()) {
        (Some(name), _) => configs.iter().find(|(known, _)| known == name),
        (None, [only]) => Some(only),
        (None, []) => None,
        (None, _) => bail!("several observatories: {}; choose one with --name", names.join(", ")),
    };
    let Some((name, config)) = chosen else {
        bail!(
            "no {}{CONFIG} in {} or its folder observatory_config; found: {}",
            name.unwrap_or("NAME"),
            folder.display(),
            if names.is_empty() { "none".to_owned() } else { names.join(", ") }
        );
    };
    let own_folder = config.parent().unwrap_or(folder);
    let first = |paths: Vec<PathBuf>| paths.into_iter().find(|path| path.is_file());
    Ok(PredecessorFiles {
        name: name.clone(),
        config: config.clone(),
        header: first(vec![own_folder.join(format!("{name}_fits_header_config.csv"))]),
        schedule: first(vec![
            folder.join("schedules").join(format!("{name}.jsonl")),
            own_folder.join(format!("{name}.jsonl")),
        ]),
        lost_catalogue: base.catalogue.clone().filter(|file| !file.is_file()),
        catalogue: base.catalogue.filter(|file| file.is_file()),
        classes: classes(&folder.join("custom_observatories")),
    })
}

/// The content of `astra_config.yml`.
#[derive(Debug, Default)]
struct Base {
    assets: Option<PathBuf>,
    catalogue: Option<PathBuf>,
    name: Option<String>,
}

impl Base {
    /// Reads it, if it is there and is one; `~` is the home folder.
    fn read(file: &Path, home: Option<&Path>) -> Option<Self> {
        let mut ignored = Notes::default();
        let node = super::salvage::read(&super::text::read(file, &mut ignored).ok()?, &mut ignored).ok()?;
        let mut entry = Entry::of(BASE, &node, &mut ignored)?;
        let mut text = |key: &str| entry.text(key, &mut ignored).filter(|text| !text.is_empty());
        let path = |text: String| match text.strip_prefix("~/").zip(home) {
            Some((rest, home)) => home.join(rest),
            None => PathBuf::from(text),
        };
        let (assets, catalogue) = (text("folder_assets").map(path), text("gaia_db").map(path));
        Some(Self { assets, catalogue, name: text("observatory_name") })
    }
}

fn is_same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Python files of a folder, but for the one that every site has.
fn classes(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_own = |path: &PathBuf| {
        path.extension().is_some_and(|ending| ending == "py") && path.file_name().is_some_and(|name| name != TEMPLATE)
    };
    let mut found: Vec<PathBuf> = files.filter(is_own).collect();
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn write(path: &Path, text: &str) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    #[test]
    fn the_file_in_the_home_folder_leads_to_the_site_and_its_catalogue() {
        let home = tempfile::tempdir().unwrap();
        let assets = home.path().join("Documents/Astra");
        for name in ["north", "south"] {
            write(&assets.join(format!("observatory_config/{name}_config.yml")), "Misc:\n");
        }
        write(&assets.join("schedules/south.jsonl"), "");
        write(&assets.join("custom_observatories/observatory_subclass.py"), "");
        write(&assets.join("custom_observatories/south.py"), "");
        write(&home.path().join("gaia.db"), "");
        let base = "folder_assets: ~/Documents/Astra\ngaia_db: ~/gaia.db\nobservatory_name: south\n";
        write(&home.path().join(".astra/astra_config.yml"), base);
        for asked in [assets.clone(), home.path().join(".astra")] {
            let found = find(&asked, None, Some(home.path())).unwrap();
            assert_eq!(
                (found.name.as_str(), found.config.parent()),
                ("south", Some(&*assets.join("observatory_config")))
            );
            assert_eq!(found.schedule, Some(assets.join("schedules/south.jsonl")));
            assert_eq!(found.catalogue, Some(home.path().join("gaia.db")));
            assert_eq!(found.classes, [assets.join("custom_observatories/south.py")]);
        }
        assert_eq!(find(&assets, Some("north"), Some(home.path())).unwrap().name, "north");
        let strangers = find(&assets, None, None).unwrap_err().to_string();
        assert!(strangers.contains("choose one with --name"), "{strangers}");
    }
}
