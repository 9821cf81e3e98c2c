//! `starmesh init` and `import-astra` at the path of a site that was deleted, and of one that lost files only.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use sha2::{Digest as _, Sha256};

/// The copy that the guard process of the dome's device node has in the state folder of an account.
fn copy_of(state: &Path, site: &Path) -> PathBuf {
    let config = site.canonicalize().unwrap().join("observatory.toml");
    let hash = Sha256::digest(config.to_string_lossy().as_bytes());
    let short: String = hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    state.join("starmesh").join(format!("{short}-enclosure.guard"))
}

/// Runs the program with the state folder of an account; returns whether it ended well, and what it printed.
fn starmesh(state: &Path, words: &[&str]) -> (bool, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_starmesh"));
    let output = command.args(words).env("XDG_STATE_HOME", state).env_remove("STATE_DIRECTORY").output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8(text).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_site_made_anew_where_one_was_deleted_has_its_first_night_and_one_that_lost_files_stays_remembered() {
    let simulator = simulator::Simulator::start(simulator::Options::default()).await.unwrap();
    let server = simulator.address().to_string();
    let home = tempfile::tempdir().unwrap();
    let astra = home.path().join("astra");
    fs::create_dir(&astra).unwrap();
    let devices = "Telescope: [{device_name: m, ip: \"h:1\"}]\nCamera: [{device_name: c, ip: \"h:2\"}]\n";
    fs::write(astra.join("old_config.yml"), devices).unwrap();
    let (astra, site) = (astra.to_str().unwrap(), home.path().join("site"));
    let to = site.to_str().unwrap();
    let init = vec!["init", to, "--server", &server];
    let forced = [&init[..], &["--force"]].concat();
    let import = vec!["import-astra", astra, "--offline", "--out", to];
    for (make, make_again) in [(&init, &forced), (&import, &import)] {
        fs::create_dir(&site).unwrap();
        let copy = copy_of(home.path(), &site);
        let other = copy.with_file_name("0123456789abcdef-enclosure.guard");
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        for file in [&copy, &other, &site.join(".observatory.toml.enclosure.guard")] {
            fs::write(file, "a copy").unwrap();
        }
        let (well, text) = starmesh(home.path(), make);
        assert!(well && copy.exists() && !text.contains("removed "), "its folder was not deleted: {text}");

        fs::remove_dir_all(&site).unwrap();
        let (well, text) = starmesh(home.path(), make);
        assert!(well && text.contains(&format!("removed {}: ", copy.display())), "{text}");
        assert!(!copy.exists() && other.exists(), "{text}");

        fs::write(&copy, "a copy").unwrap();
        let (_, text) = starmesh(home.path(), make_again);
        assert!(copy.exists() && !text.contains("removed "), "the site is there: {text}");
        fs::remove_dir_all(&site).unwrap();
    }
    simulator.stop().await;
}
