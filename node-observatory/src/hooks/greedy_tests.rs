//! Scripts that want all there is: of memory, of the stack, of time, of this node's own functions, and of the reader.
//!
//! Each ends with a fault that can be reported, soon (which `proof` measures) and small. The consequence of a fault, closing by default, is a
//! scenario of its own (`obeys_the_sites_script`).

use std::fmt::Write as _;
use std::sync::Mutex;
use std::time::Duration;

use super::line::{Host, HostAnswer, Reply, Request};
use super::script::{Function, LONGEST, Script};

/// Answers at once that it is done, and counts.
#[derive(Default)]
struct Obliging {
    asked: Mutex<usize>,
}

impl Host for Obliging {
    async fn answer(&self, _: Request) -> HostAnswer {
        *self.asked.lock().unwrap() += 1;
        Ok(Reply::Done)
    }
}

/// Calls `close` of a script, at most so long; the fault in words, or nothing.
async fn close(text: &str, most: Duration) -> Result<(), String> {
    let script = Script::compile(text).unwrap_or_else(|faults| panic!("{faults:?}: {text}"));
    // The other tests of this process may take memory meanwhile.
    script
        .call_within(Function::Close, most, u64::MAX, &Obliging::default())
        .await
        .map(drop)
        .map_err(|error| error.to_string())
}

/// Only what hangs takes so long.
const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_millis(200);

const TEXT: &str = "length of string";
const ARRAY: &str = "size of array";
const MAP: &str = "size of object map";
/// Bodies that grow, and by which limit they are stopped.
const GROWING: [(&str, &str); 11] = [
    ("let s = \"x\"; loop { s = `${s}${s}`; }", TEXT),
    ("let s = \"x\"; loop { s = s + s; }", TEXT),
    ("let a = []; loop { a.push(\"0123456789abcdef\".to_upper() + a.len()); a += a; }", ARRAY),
    ("let s = \"x\"; s.pad(60000, 'x'); let a = []; loop { a.push(s + a.len()); }", TEXT),
    ("let a = [1]; loop { a.append(a); }", ARRAY),
    ("let a = [[]]; loop { a[0].push(a); }", ARRAY),
    ("let b = blob(); loop { b.push(7); }", ARRAY),
    ("let b = blob(1000000000);", ARRAY),
    ("let m = #{}; loop { m = #{ a: m, b: m }; }", MAP),
    ("let m = #{ s: \"x\" }; loop { m.s += m.s; }", TEXT),
    ("let a = []; for n in 0..1000000000 { a.push(n); }", ARRAY),
];

#[tokio::test]
async fn whatever_grows_is_stopped_while_it_is_small() {
    for (body, limit) in GROWING {
        let error = close(&format!("fn close() {{ {body} }}"), LONG).await.unwrap_err();
        assert!(error.to_lowercase().contains(limit), "{body}: {error}");
    }
    let many: String = (0..100).fold(String::new(), |mut text, n| {
        let _ = write!(text, "let v{n} = {n};");
        text
    });
    let error = close(&format!("fn close() {{ {many} }}"), LONG).await.unwrap_err();
    assert!(error.contains("Too many variables"), "{error}");
}

#[tokio::test]
async fn functions_within_functions_end_before_the_stack_does() {
    let brackets = format!("{}deeper(n + 1){}", "(".repeat(16), ")".repeat(16));
    for text in [
        "fn close() { deeper(0); } private fn deeper(n) { deeper(n + 1); }".to_owned(),
        "fn close() { one(0); } private fn one(n) { other(n); } private fn other(n) { one(n); }".to_owned(),
        "fn close() { let f = Fn(\"deeper\"); f.call(1); } private fn deeper(n) { let f = Fn(\"deeper\"); f.call(n); }"
            .to_owned(),
        "fn close() { deeper(0); } private fn deeper(n) { [n].map(|x| deeper(x)); }".to_owned(),
        "fn close() { close(); }".to_owned(),
        format!("fn close() {{ deeper(0); }} private fn deeper(n) {{ if true {{ {brackets} }} }}"),
    ] {
        let error = close(&text, LONG).await.unwrap_err();
        assert!(error.contains("Stack overflow") || error.contains("stack overflow"), "{text}: {error}");
    }
}

/// Bodies without an end.
const ENDLESS: [&str; 7] = [
    "let m = 0; for n in 0..9000000000000000000 { m = n; }",
    "let n = 0; while true { n = (n + 1) % 7; }",
    "let n = 0; do { n = 1 - n; } while true;",
    "let a = []; a.pad(900, 1); loop { a.sort(|x, y| x - y); a.reverse(); }",
    "let s = \"\"; s.pad(6000, 'x'); loop { s.replace(\"x\", \"x\"); s.index_of(\"y\"); s.split(\"xxxxxxxx\"); }",
    "loop { try { sleep(0); default_close(); } catch { } }",
    "loop { try { throw 1 } catch { try { throw 2 } catch { } } }",
];

#[tokio::test]
async fn work_without_end_is_ended_by_its_time_whatever_it_is_made_of() {
    for body in ENDLESS {
        let error = close(&format!("fn close() {{ {body} }}"), SHORT).await.expect_err(body);
        assert!(error.contains("not done within 0.2 s"), "{body}: {error}");
    }
}

#[tokio::test]
async fn the_default_may_be_called_a_thousand_times() {
    let host = Obliging::default();
    let script = Script::compile("fn close() { for n in 0..1000 { default_close(); } }").unwrap();
    drop(script.call(Function::Close, LONG, &host).await.unwrap());
    assert_eq!(*host.asked.lock().unwrap(), 1000);
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_is_filled_entry_by_entry_is_ended_by_the_memory_that_it_takes() {
    for filling in ["m[s + n] = n;", "m[`${n}`] = s + n;", "m.inner[s + n] = n;"] {
        let text = format!(
            "fn close() {{ let s = \"\"; s.pad(60000, 'x'); let m = #{{ inner: #{{}} }}; let n = 0; \
             loop {{ try {{ {filling} n += 1; }} catch {{ }} }} }}"
        );
        let script = Script::compile(&text).unwrap();
        let message = script.call_within(Function::Close, LONG, 32 << 20, &Obliging::default()).await.map(drop);
        let message = message.unwrap_err().to_string();
        assert!(message.contains("memory grew by more than 32 MiB"), "{filling}: {message}");
    }
}

fn refused(text: &str) -> String {
    let faults = Script::compile(text).map(|_| ()).unwrap_err();
    let text = faults.join("; ");
    assert!(text.len() < 16 << 10, "{} bytes are reported", text.len());
    text
}

#[test]
fn a_text_without_end_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hooks.rhai");
    // An endless line, and one whose character is cut in the middle.
    for filling in ["/", "a", "é"] {
        std::fs::write(&path, format!("fn close() {{ }}\n//{}", filling.repeat(8 << 20))).unwrap();
        let error = Script::read(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("more than 65536 bytes"), "{error}");
    }
    let fits = format!("fn close() {{ }}\n//{}", "x".repeat(LONGEST - 17));
    assert_eq!(fits.len(), LONGEST);
    std::fs::write(&path, &fits).unwrap();
    assert_eq!(Script::read(&path).unwrap().names(), ["close"]);
}

/// Texts of brackets within brackets, and without their other halves.
fn brackets() -> Vec<String> {
    let kinds = [("(", ")"), ("[", "]"), ("{", "}"), ("if true {", "}"), ("-", "1"), ("!", "true"), ("#{a:", "}")];
    let texts = kinds.into_iter().flat_map(|(open, close)| {
        let most = (LONGEST - 100) / (open.len() + close.len());
        [
            format!("fn close() {{ let x = {}1{}; }}", open.repeat(most), close.repeat(most)),
            format!("fn close() {{ let x = {}", open.repeat(LONGEST / open.len() - 100)),
        ]
    });
    texts.collect()
}

#[test]
fn brackets_within_brackets_are_refused_before_the_stack_ends() {
    for text in brackets() {
        assert!(!refused(&text).is_empty());
    }
}

#[test]
fn thousands_of_faults_are_reported_as_a_few() {
    let many = (0..3000).fold(String::new(), |mut text, n| {
        let _ = writeln!(text, "fn x{n}() {{}}");
        text
    });
    assert!(refused(&many).ends_with("and more"));
    let slips = "default_opne(); ".repeat(4000);
    assert!(refused(&format!("fn open() {{ {slips} }}")).ends_with("and more"));
    refused(&format!("fn {}() {{ }}", "a".repeat(60_000)));
    refused(&format!("fn open() {{ {}(1 }}", "a".repeat(60_000)));
}

mod proof {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Instant;

    use super::*;

    // How soon a script is ended, and a text refused, is measured.
    #[tokio::test]
    async fn what_grows_what_has_no_end_and_what_cannot_be_read_is_ended_soon() {
        for (body, _) in GROWING {
            let began = Instant::now();
            close(&format!("fn close() {{ {body} }}"), LONG).await.unwrap_err();
            assert!(began.elapsed() < Duration::from_secs(20), "{body}: {:?}", began.elapsed());
        }
        for body in ENDLESS {
            let began = Instant::now();
            close(&format!("fn close() {{ {body} }}"), SHORT).await.unwrap_err();
            assert!(began.elapsed() < Duration::from_secs(5), "{body}: {:?}", began.elapsed());
        }
        for text in brackets() {
            let began = Instant::now();
            refused(&text);
            assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
        }
    }

    /// Resident memory of this process, bytes.
    fn resident() -> usize {
        let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
        pages.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() * 4096
    }

    // Memory is measured while other tests of this process may run.
    #[cfg(target_os = "linux")]
    #[tokio::test(flavor = "multi_thread")]
    async fn full_variables_at_every_depth_are_some_hundred_megabytes_and_no_more() {
        // Each variable a map of its own, in functions as deep as they go, and none is given back before the end.
        let copies = (0..60).fold(String::new(), |mut text, n| {
            let _ = write!(text, "let v{n} = m; v{n}.own = {n};");
            text
        });
        let text = format!(
            "fn close() {{ let m = #{{}}; for n in 0..490 {{ m[`key number ${{n}} of the map`] = n; }} deeper(m); }}\n\
             private fn deeper(m) {{ {copies} deeper(m); }}"
        );
        // (the other tests of this process run meanwhile).
        let (before, over) = (resident(), AtomicBool::new(false));
        let watching = async {
            let mut most = 0;
            while !over.load(Ordering::Relaxed) {
                most = most.max(resident().saturating_sub(before));
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            most
        };
        let calling = async {
            let script = Script::compile(&text).unwrap();
            let result = script.call(Function::Close, LONG, &Obliging::default()).await.map(drop);
            over.store(true, Ordering::Relaxed);
            result
        };
        let (result, most) = tokio::join!(calling, watching);
        let result = result.unwrap_err().to_string();
        assert!(result.to_lowercase().contains("stack overflow"), "{result}");
        // The other tests of this process need some too.
        assert!(most < 500 << 20, "{} MiB", most >> 20);
        assert!(most > 10 << 20, "{} MiB: it was not seen at work", most >> 20);
    }
}
