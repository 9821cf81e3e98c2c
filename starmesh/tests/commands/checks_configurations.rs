//! `starmesh check` of wrong configurations: every fault with its line, in words of the field, and nothing that cannot
//! run.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpListener;

use crate::command::starmesh;
use crate::wrong::{FOREIGN, GOOD, WRONG, Wrong, changed};

/// The text that is added to the good file or replaces a part of it, the line at fault of the result, and words of the
/// message.
const FILES: &[(&str, &str, usize, &[&str])] = &[
    ("[safety]", "[folders]\ndata = \"a_file\"\n[safety]", 9, &["folders.data", "a_file is no folder"]),
    ("[safety]", "[folders]\nimages = \"a_file/images\"\n[safety]", 9, &["folders.images", "a_file is no folder"]),
    ("[safety]", "[folders]\nimages = \"/proc/images\"\n[safety]", 9, &["folders.images", "nothing can be written"]),
    (
        "[safety]",
        "[web]\nlisten = \"0.0.0.0:8080\"\n[safety]",
        9,
        &["web.listen = \"0.0.0.0:8080\"", "starmesh user add"],
    ),
    ("[safety]", "[web]\ntrust_proxy = [\"::1\"]\n[safety]", 9, &["web.trust_proxy", "starmesh user add"]),
    ("[safety]", "[web]\nusers = \"a_folder\"\n[safety]", 9, &["web.users", "a_folder"]),
    ("[safety]", "[web]\nusers = \"a_file\"\n[safety]", 9, &["web.users", "a_file, line 1"]),
    ("[safety]", "[web]\ncertificate = \"none.pem\"\nkey = \"a_file\"\n[safety]", 9, &["web.certificate", "none.pem"]),
    ("[safety]", "[web]\ncertificate = \"a_file\"\nkey = \"a_file\"\n[safety]", 9, &["web.certificate", "PEM"]),
    ("data/archive.db", "a_folder", 12, &["archive.database", "a_folder is a folder"]),
    ("data/archive.db", "a_file", 12, &["archive.database", "no database of SQLite"]),
    (
        "data/archive.db\"",
        "d.db\"\nfits_header = \"none.csv\"",
        13,
        &["archive.fits_header", "there is no file", "none.csv"],
    ),
    ("data/archive.db\"", "d.db\"\nfits_header = \"wrong.csv\"", 13, &["wrong.csv", "line 2", "expected str, int"]),
    ("data/archive.db\"", "d.db\"\nfits_header = \"latin.csv\"", 13, &["latin.csv", "line 2", "not UTF-8", "Latin-1"]),
    (
        "data/archive.db\"",
        "d.db\"\n[archive.filename]\nobject = \"{objct}.fits\"",
        14,
        &["archive.filename.object", "\"objct\" is no variable", "object_name"],
    ),
    (
        "data/archive.db\"",
        "d.db\"\n[archive.filename]\nobject = \"{object_name\"",
        14,
        &["archive.filename.object", "brace"],
    ),
    (
        "data/archive.db\"",
        "d.db\"\n[archive.filename]\nflats = \"../x.fits\"",
        14,
        &["archive.filename.flats", "leads out"],
    ),
    ("data/archive.db\"", "d.db\"\n[imaging]\ncatalogue = \"none.smcat\"", 14, &["imaging.catalogue", "none.smcat"]),
    ("data/archive.db\"", "d.db\"\n[imaging]\ncatalogue = \"a_file\"", 14, &["imaging.catalogue", "a_file"]),
    ("data/archive.db\"", "d.db\"\n[hooks]\nscript = \"none.rhai\"", 14, &["hooks.script", "there is no file"]),
    ("data/archive.db\"", "d.db\"\n[hooks]\nscript = \"wrong.rhai\"", 14, &["hooks.script", "wrong.rhai"]),
    ("data/archive.db\"", "d.db\"\n[schedule]\nfile = \"a_folder\"", 14, &["schedule.file", "is a folder"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = \"none.txt\"", 17, &["telescope \"mount\": horizon", "none.txt"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = \"wall.txt\"", 17, &["wall.txt", "line 1", "no pair of numbers"]),
    (
        "data/archive.db\"",
        "d.db\"\n[[alerts.webhook]]\nname = \"chat\"\nurl = \"https://a b\"",
        15,
        &["alerts.webhook.url", "expected http://"],
    ),
    (
        "data/archive.db\"",
        "d.db\"\n[[alerts.webhook]]\nname = \"chat\"\nurl = \"https://a.b:99999/x\"",
        15,
        &["alerts.webhook[0].url", "port"],
    ),
    (
        "data/archive.db\"",
        "d.db\"\n[[alerts.webhook]]\nname = \"chat\"\nurl = \"https://a.b/x\"\ntoken_file = \"none\"",
        16,
        &["token_file", "there is no file"],
    ),
    ("data/archive.db\"", "d.db\"\n[alerts]\nca_file = \"a_file\"", 14, &["alerts.ca_file", "no certificate"]),
];

#[test]
fn every_wrong_file_is_reported_by_the_program_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("a_file"), "no folder").unwrap();
    fs::create_dir(path("a_folder")).unwrap();
    fs::write(path("wall.txt"), "0 ten\n").unwrap();
    fs::write(path("wrong.rhai"), "fn before_open( {").unwrap();
    let head = "header,dtype,fixed,device_type,device_command,comment\n";
    fs::write(path("wrong.csv"), format!("{head}A,text,true,static,x,\n")).unwrap();
    fs::write(path("latin.csv"), [head.as_bytes(), b"A,str,true,static,\xe9,\n"].concat()).unwrap();
    let file = path("observatory.toml");
    let mut failed = Vec::new();
    let on_disk: Vec<Wrong> = FILES.to_vec();
    for wrong in WRONG.iter().chain(&on_disk) {
        fs::write(&file, changed(wrong)).unwrap();
        let output = starmesh(["check", &file.display().to_string()]);
        let (_, to, number, words) = wrong;
        let place = format!("observatory.toml:{number}:");
        let line = output.out.lines().find(|line| line.contains(&place) && line.contains(": error: "));
        let is_reported = line.is_some_and(|line| words.iter().all(|word| line.contains(word)));
        let all = format!("{}{}", output.out, output.err);
        let foreign = FOREIGN.iter().find(|word| all.contains(**word));
        let alone = output.out.matches(": error: ").count() == 1 && output.err.contains("1 errors");
        if output.success || !is_reported || foreign.is_some() || !alone {
            failed.push(format!("{to:?}, line {number}, {words:?}, {foreign:?}:\n{all}"));
        }
    }
    let count = WRONG.len() + FILES.len();
    assert!(failed.is_empty(), "{} of {count}:\n\n{}", failed.len(), failed.join("\n\n"));
}

#[test]
fn a_test_message_goes_to_those_who_get_alerts_and_who_was_not_reached_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("observatory.toml");
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let receivers = format!(
        "[[alerts.webhook]]\nname = \"desk\"\nurl = \"http://{}/night\"\n[[alerts.webhook]]\nname = \"gone\"\n\
         url = \"http://127.0.0.1:1/\"\n",
        server.local_addr().unwrap()
    );
    fs::write(&file, format!("{GOOD}{receivers}")).unwrap();
    let taken = std::thread::spawn(move || {
        let (mut stream, _) = server.accept().unwrap();
        let (mut got, mut part) = (String::new(), [0; 4096]);
        while !got.contains("Nothing is wrong.") {
            let count = stream.read(&mut part).unwrap();
            assert!(count > 0, "{got}");
            got += &String::from_utf8_lossy(&part[..count]);
        }
        stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n").unwrap();
    });
    let output = starmesh(["check", &file.display().to_string(), "--send-test-message"]);
    taken.join().unwrap();
    assert!(
        !output.success && output.err.contains("1 of 2 who get alerts were not reached"),
        "{}{}",
        output.out,
        output.err
    );
    assert!(output.out.contains("  test message to desk (webhook): taken by its server"), "{}", output.out);
    assert!(output.out.contains("  test message to gone (webhook): not sent: it cannot be reached"), "{}", output.out);
    fs::write(&file, GOOD).unwrap();
    let output = starmesh(["check", &file.display().to_string(), "--send-test-message"]);
    assert!(!output.success && output.err.contains("[alerts] names nobody"), "{}{}", output.out, output.err);
}

#[test]
fn a_good_file_is_valid_and_one_without_a_monitor_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("observatory.toml");
    // The page's usual port may be taken on the machine of a test.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    fs::write(&file, format!("{GOOD}[web]\nlisten = \"{free}\"\n")).unwrap();
    let output = starmesh(["check", &file.display().to_string()]);
    assert!(output.success && !output.out.contains("warning"), "{}{}", output.out, output.err);
    let public = "public = [\"/api/hartbeat\", \"/api/v1/telescopes/a/b/safety\", \"/metrics\"]";
    fs::write(&file, format!("{GOOD}[web]\nlisten = \"{free}\"\n{public}\n")).unwrap();
    let output = starmesh(["check", &file.display().to_string()]);
    let warned = "warning: web.public: nothing is answered at \"/api/hartbeat\"; did you mean \"/api/heartbeat\"?";
    assert!(
        output.success && output.out.contains(warned) && output.out.matches("warning: ").count() == 1,
        "{}",
        output.out
    );
    // A schedule may come later, unless the file names it; also under its usual name.
    fs::write(&file, format!("{GOOD}[web]\nlisten = \"{free}\"\n[schedule]\nfile = \"schedule.jsonl\"\n")).unwrap();
    let output = starmesh(["check", &file.display().to_string()]);
    let warned = "warning: schedule.file: there is no file";
    assert!(output.success && output.out.contains(warned), "{}{}", output.out, output.err);
    fs::write(folder.path().join("schedule.jsonl"), "").unwrap();
    let output = starmesh(["check", &file.display().to_string()]);
    assert!(!output.out.contains(warned), "{}{}", output.out, output.err);
    fs::remove_file(folder.path().join("schedule.jsonl")).unwrap();
    let cut = GOOD.find("[[safetymonitor]]").unwrap();
    // As an editor on Windows saves it.
    fs::write(&file, format!("\u{feff}{}", GOOD[..cut].replace('\n', "\r\n"))).unwrap();
    let output = starmesh(["check", &file.display().to_string()]);
    assert!(output.success && output.out.contains("warning: no safety monitor"), "{}{}", output.out, output.err);
    // Other encodings.
    let utf16: Vec<u8> = GOOD.encode_utf16().flat_map(u16::to_le_bytes).collect();
    for bytes in [b"[observatory]\nsite = \"\xe9\"\n".to_vec(), [b"\xff\xfe".to_vec(), utf16].concat()] {
        fs::write(&file, bytes).unwrap();
        let output = starmesh(["check", &file.display().to_string()]);
        assert!(!output.success && output.err.contains("as UTF-8"), "{}{}", output.out, output.err);
    }
    let output = starmesh(["check", &folder.path().join("none.toml").display().to_string()]);
    assert!(!output.success && output.err.contains("none.toml"), "{}", output.err);
}
