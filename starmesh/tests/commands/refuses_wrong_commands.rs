//! Commands as people mistype them: each ends with an error that names what was wrong and what to type instead, in words
//! of the field.

use std::fs;
use std::path::Path;

use crate::command::{Output, starmesh};
use crate::wrong::FOREIGN;

/// What is typed, with `DIR` for the folder of the test, and words of the message.
type Typed = (&'static str, &'static [&'static str]);

const TYPED: &[Typed] = &[
    // a file that is not there, a folder in the place of a file, a file of another sort
    ("up DIR/none.toml", &["none.toml", "make one with `starmesh init`"]),
    ("up DIR", &["name the file in it, such as observatory.toml"]),
    ("up DIR/broken.fits", &["broken.fits is not a valid configuration", "line 1", "key = value"]),
    ("check DIR/none.toml", &["none.toml", "make one with `starmesh init`"]),
    ("check DIR/none.jsonl", &["cannot read", "none.jsonl"]),
    ("check DIR/rows.jsonl --config DIR/none.toml", &["none.toml", "make one with `starmesh init`"]),
    ("plan DIR/none.jsonl", &["cannot read", "none.jsonl"]),
    ("plan DIR/empty", &["no schedule ends in .jsonl there"]),
    ("schedule list --config DIR/none.toml", &["name the configuration by --config", "none.toml"]),
    ("schedule show 3 --config DIR/observatory.toml", &["has no version 3"]),
    ("node archive --config DIR/none.toml", &["none.toml", "make one with `starmesh init`"]),
    ("archive backup DIR/copy.db --config DIR/none.toml", &["none.toml"]),
    ("archive restore DIR/none.db --config DIR/observatory.toml", &["none.db is not there"]),
    ("audit verify DIR/none.jsonl", &["cannot read", "none.jsonl"]),
    ("audit verify DIR/broken.fits", &["line 1 is broken"]),
    ("import-astra DIR/none", &["DIR/none is no folder"]),
    ("import-astra DIR/empty", &["no NAME_config.yml in DIR/empty"]),
    // images
    ("measure DIR/none.fits", &["none.fits cannot be read"]),
    ("measure DIR/empty.fits", &["is empty (0 bytes)", "copy or fetch it again"]),
    ("measure DIR/broken.fits", &["is not FITS", "write it again"]),
    ("measure DIR/random.fits", &["is not FITS", "give a FITS file, plain, .fz, .gz or .bz2"]),
    ("measure DIR/broken.fits --hdu 0", &["--hdu", "expected a number of 1 and more"]),
    ("shift DIR/broken.fits DIR/empty.fits", &["broken.fits is not FITS"]),
    ("focus DIR/broken.fits", &["broken.fits is not FITS"]),
    ("solve DIR/broken.fits --ra-deg 84", &["give both --ra-deg and --dec-deg, or none of them"]),
    ("solve DIR/broken.fits --catalogue DIR/none.smcat", &["none.smcat"]),
    ("catalogue build --out DIR/new.smcat DIR/none.csv", &["none.csv"]),
    // words and numbers
    ("actions observe", &["no action is called \"observe\"", "object", "autofocus"]),
    ("plan DIR/rows.jsonl --unsafe yesterday", &["expected FROM..TO such as 2026-11-21T03:00:00Z"]),
    ("audit show DIR/rows.jsonl --since yesterday", &["--since", "\"yesterday\" is no time", "expected UTC such as"]),
    ("simulator --bind nowhere", &["--bind", "expected an address and a port, such as 127.0.0.1:11111"]),
    ("simulator --speed 0", &["--speed 0", "expected 0 to 5000"]),
    ("simulator --shutter-s -3", &["-3"]),
    // telescopes and peers
    ("order callisto close --no-multicast", &["\"callisto\" is no telescope", "expected SITE/TELESCOPE"]),
    ("order paranal/callisto/roof close --no-multicast", &["is no telescope", "expected SITE/TELESCOPE"]),
    ("order paranal/callisto override --no-multicast", &["<INPUT>"]),
    ("order paranal/callisto cloze --no-multicast", &["cloze", "close"]),
    ("status --connect 10.0.0.5 --no-multicast", &["--connect", "names no protocol", "tcp/10.0.0.5:7447"]),
    ("tail --connect tcp/10.0.0.5 --no-multicast", &["--connect", "has no port", "tcp/10.0.0.5:7447"]),
    ("tail --connect tcp/10.0.0.5:99999 --no-multicast", &["99999", "1 to 65535"]),
    ("order a/b close --connect http/x:1 --no-multicast", &["the protocol http, which is not known here"]),
    ("schedule put paranal/callisto DIR/none.jsonl --reason x --no-multicast", &["cannot read", "none.jsonl"]),
    ("frobnicate", &["unrecognized subcommand 'frobnicate'"]),
];

/// Words of a programmer that a person at a telescope has no use for, and those that clap and the system say themselves.
fn foreign(text: &str) -> Option<&'static str> {
    let from_elsewhere = [".rs:", "panicked", "RUST_BACKTRACE", "unwrap", "src/", "registry"];
    FOREIGN.iter().copied().chain(from_elsewhere).find(|word| text.contains(word))
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
    fs::create_dir(folder.path().join("empty")).unwrap();
    put("broken.fits", b"SIMPLE");
    put("empty.fits", b"");
    put("random.fits", &(0..5760u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect::<Vec<u8>>());
    put("rows.jsonl", b"");
    let text = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n\
                elevation_m = 2500\n[bus]\nmulticast = false\n[[camera]]\nname = \"main\"\nserver = \"127.0.0.1:9\"\n";
    put("observatory.toml", text.as_bytes());
    folder
}

fn call(typed: &str, folder: &Path) -> Output {
    let shown = folder.display().to_string();
    starmesh(typed.split_whitespace().map(|word| word.replace("DIR", &shown)))
}

#[test]
fn each_mistyped_command_fails_with_what_was_wrong_and_what_to_type() {
    let folder = folder();
    let shown = folder.path().display().to_string();
    let files = || {
        let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = files();
    let mut failed = Vec::new();
    for (typed, words) in TYPED {
        let Output { success, out, err } = call(typed, folder.path());
        let text = format!("{out}{err}");
        let lacks: Vec<&str> =
            words.iter().copied().filter(|word| !text.contains(&word.replace("DIR", &shown))).collect();
        if success || !lacks.is_empty() || foreign(&text).is_some() || text.lines().count() > 12 {
            failed.push(format!("{typed}: success {success}, lacks {lacks:?}, has {:?}:\n{text}", foreign(&text)));
        }
    }
    assert!(failed.is_empty(), "{} of {}:\n\n{}", failed.len(), TYPED.len(), failed.join("\n"));
    // What is refused leaves nothing behind but the folders that the configuration names.
    let is_own = |name: &str| ["data", "images"].contains(&name);
    let after: Vec<_> = files().into_iter().filter(|name| !is_own(&name.to_string_lossy())).collect();
    assert_eq!(after, before);
}

#[test]
fn each_command_has_a_help_that_names_its_arguments_and_no_programmers_words() {
    let help = starmesh(["--help"]);
    assert!(help.success);
    let from = help.out.find("Commands:").unwrap();
    let until = help.out[from..].find("\n\n").map_or(help.out.len(), |length| from + length);
    let commands: Vec<&str> = help.out[from..until]
        .lines()
        .skip(1)
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .collect();
    assert!(commands.len() > 20 && commands.contains(&"archive"), "{commands:?}");
    for command in commands {
        let help = starmesh([command, "--help"]);
        assert!(help.success && help.out.contains("Usage:"), "{command}: {}", help.err);
        let first = help.out.lines().next().unwrap();
        assert!(first.len() > 15, "{command} has no description: {first:?}");
        assert_eq!(foreign(&help.out.replace("Options:", "")), None, "{command}:\n{}", help.out);
    }
}
