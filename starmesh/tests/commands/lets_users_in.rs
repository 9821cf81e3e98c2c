//! `starmesh user`, as the person runs it who decides about the page.

use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::command::{Output, starmesh};
use crate::wrong::GOOD;

const PASSWORD: &str = "four plain words here";

/// Calls `starmesh user` with a password on its standard input.
fn user(folder: &Path, arguments: &str, password: &str) -> Output {
    let mut call = Command::new(env!("CARGO_BIN_EXE_starmesh"));
    call.arg("user").args(arguments.split(' ')).arg("--config").arg(folder.join("observatory.toml"));
    let mut child = call.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // A command that refuses its arguments does not read it.
    let _ = child.stdin.take().unwrap().write_all(format!("{password}\n").as_bytes());
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Output { success: output.status.success(), out: text(output.stdout), err: text(output.stderr) }
}

fn site() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("observatory.toml"), GOOD).unwrap();
    folder
}

#[test]
fn a_user_is_added_changed_and_removed_and_the_file_holds_no_secret() {
    let folder = site();
    let done = |arguments: &str| {
        let output = user(folder.path(), arguments, PASSWORD);
        assert!(output.success, "{arguments}: {}", output.err);
        output.out
    };
    let added = done("add ana --right operator:paranal/* --right viewer --password-file -");
    assert!(added.contains("everybody has to log in"), "{added}");
    assert!(!added.contains("warning"), "{added}");
    done("add bob --right viewer --password-file -");
    let token = done("token add ana --name cron --days 30 --right viewer");
    let token = token.trim();
    assert!(token.starts_with("starmesh_") && token.len() == 73, "{token}");
    assert!(done("token list").contains("cron") && done("list").contains("operator:paranal/*, viewer  (1 tokens)"));
    let read = || users::read(&folder.path().join("users.toml")).unwrap().unwrap();
    let before = read();
    assert!(before.log_in("ana", PASSWORD).is_some());
    let text = fs::read_to_string(folder.path().join("users.toml")).unwrap();
    assert!(!text.contains(token) && !text.contains(PASSWORD), "{text}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = fs::metadata(folder.path().join("users.toml")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let strange = done("right bob viewer operator:paranal/calisto");
    assert!(strange.contains("warning: operator:paranal/calisto is not for paranal/"), "{strange}");
    done("right bob engineer");
    done("password ana --password-file -");
    let after = read();
    let (ana, bob) = ("ana".parse().unwrap(), "bob".parse().unwrap());
    assert_ne!(after.users[&ana].password, before.users[&ana].password);
    assert_eq!(after.users[&bob].grants, ["engineer".parse().unwrap()]);
    assert!(done("remove ana").contains("with 1 tokens"));
    assert!(read().tokens.is_empty() && read().users.len() == 1);
    let file = folder.path().join("users.toml");
    let whole = fs::read_to_string(&file).unwrap();
    done("add eve --right engineer:paranal/* --password-file -");
    for taken in ["remove bob", "right bob operator", "right bob engineer:paranal/*"] {
        let before = fs::read_to_string(&file).unwrap();
        let output = user(folder.path(), taken, "");
        assert!(!output.success && output.err.contains("make another engineer first"), "{taken}: {}", output.err);
        assert!(output.err.contains("starmesh user add") && output.err.contains("users.toml"), "{}", output.err);
        assert_eq!(fs::read_to_string(&file).unwrap(), before, "{taken}");
    }
    done("right eve engineer viewer");
    done("remove bob");
    assert!(!user(folder.path(), "remove eve", "").success);
    // Whom nobody could change on the page anyway, the command may remove.
    fs::write(&file, whole.replace("\"engineer\"", "\"operator\"")).unwrap();
    assert!(done("remove bob").contains("nobody can log in"));
}

#[test]
fn what_no_user_or_token_can_be_is_refused_and_changes_nothing() {
    let folder = site();
    assert!(user(folder.path(), "list", "").err.contains("starmesh user add"), "there is none yet");
    assert!(user(folder.path(), "add ana --right viewer:paranal/* --password-file -", PASSWORD).success);
    let file = folder.path().join("users.toml");
    let before = fs::read_to_string(&file).unwrap();
    for (arguments, password, why) in [
        ("add bob --right viewer --password-file -", "short", "expected 12 or more"),
        ("add bob --right viewer --password-file -", "bob-bob-bob-bob", "easily guessed"),
        ("add bob --right viewer --password-file -", "", "0 characters"),
        ("add bob --right viewer --password-file none", PASSWORD, "cannot read the password in none"),
        ("add bob --right viewer", PASSWORD, "--password-file"),
        ("add bob --password-file -", PASSWORD, "--right"),
        ("add bob --right root --password-file -", PASSWORD, "is no grant"),
        ("add b/b --right viewer --password-file -", PASSWORD, "is no name"),
        ("add ana --right viewer --password-file -", PASSWORD, "there is a user ana already"),
        ("add ANA --right viewer --password-file -", PASSWORD, "could be taken for"),
        ("add local --right viewer --password-file -", PASSWORD, "choose another"),
        ("password bob --password-file -", PASSWORD, "there is no user bob"),
        ("password ana --password-file -", "short", "expected 12 or more"),
        ("right bob viewer", "", "there is no user bob"),
        ("right ana", "", "RIGHT"),
        ("remove bob", "", "there is no user bob"),
        ("token add bob --name cron", "", "there is no user bob"),
        ("token add ana --name cron --right operator", "", "is more than ana may do"),
        ("token add ana --name cron --days 0", "", "1..=3650"),
        ("token remove cron", "", "there is no token cron"),
    ] {
        let output = user(folder.path(), arguments, password);
        assert!(!output.success && output.err.contains(why), "{arguments}: {} {}", output.out, output.err);
        assert_eq!(fs::read_to_string(&file).unwrap(), before, "{arguments}");
    }
}

#[test]
fn a_page_for_others_is_checked_like_it_is_served() {
    let folder = site();
    let file = folder.path().join("observatory.toml");
    fs::write(&file, format!("{GOOD}\n[web]\nlisten = \"0.0.0.0:0\"\n")).unwrap();
    let check = || starmesh(["check", file.to_str().unwrap()]);
    let refused = check();
    assert!(!refused.success && refused.out.contains("starmesh user add"), "{} {}", refused.out, refused.err);
    assert!(user(folder.path(), "add ana --right viewer --password-file -", PASSWORD).success);
    let taken = check();
    assert!(taken.success && taken.out.contains("1 users and 0 tokens"), "{} {}", taken.out, taken.err);
    fs::remove_file(folder.path().join("users.toml")).unwrap();
    fs::write(&file, format!("{GOOD}\n[web]\nlisten = \"0.0.0.0:0\"\ninsecure_open = true\n")).unwrap();
    let warned = check();
    assert!(warned.success && warned.out.contains("may open the dome"), "{} {}", warned.out, warned.err);
}
