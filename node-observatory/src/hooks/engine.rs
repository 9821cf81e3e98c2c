//! The engine that scripts run in: its limits, and the functions that it gives them. There are no others.
//!
//! No file, no network, no process and no other script can be reached: the engine is built without modules and `eval`,
//! and what it prints goes nowhere.

use contract::device::vendor::{VendorCommand, Words};
use rhai::packages::{Package as _, StandardPackage};
use rhai::{Array, Dynamic, Engine, EvalAltResult, FLOAT, INT, Map, Position};
use serde_json::Value;

use super::line::{Over, Reply, Request, ScriptLine};

/// Names of the functions that scripts are given.
pub const CALLS: [&str; 13] = [
    "default_open",
    "default_close",
    "open_domes",
    "open_covers",
    "unpark",
    "is_safe",
    "note",
    "sleep",
    "state",
    "command_string",
    "command_bool",
    "command_blind",
    "action",
];

/// Steps of work of one call: an endless loop without a wait ends here if not by its time.
const OPERATIONS: u64 = 20_000_000;
/// Functions within functions; also bounds the stack.
const CALL_DEPTH: usize = 24;
/// Brackets within brackets of the text.
const EXPRESSION_DEPTH: usize = 64;
/// Bytes of one text, or of all texts in one list together.
const TEXT: usize = 64 * 1024;
/// Entries of one list or map, with what they hold in turn; a device's state has some dozens.
const ENTRIES: usize = 1_000;
/// Variables of one function at one time. With the three limits above all that a script can hold is some 100 MB: a text
/// of 64 KiB, or a map of as much, in each variable at each depth.
const VARIABLES: usize = 64;

/// An engine that can compile and count, and reaches nothing.
pub fn bare() -> Engine {
    let mut engine = Engine::new_raw();
    StandardPackage::new().register_into_engine(&mut engine);
    engine.set_max_operations(OPERATIONS);
    engine.set_max_call_levels(CALL_DEPTH);
    engine.set_max_expr_depths(EXPRESSION_DEPTH, EXPRESSION_DEPTH);
    engine.set_max_string_size(TEXT);
    engine.set_max_array_size(ENTRIES);
    engine.set_max_map_size(ENTRIES);
    engine.set_max_variables(VARIABLES);
    engine.set_strict_variables(true);
    engine.disable_symbol("eval");
    engine.on_print(|_| {});
    engine.on_debug(|_, _, _| {});
    engine
}

type Fallible<T> = Result<T, Box<EvalAltResult>>;

/// An engine whose functions exchange requests and answers over a line.
pub fn with_line(line: &ScriptLine) -> Engine {
    let mut engine = bare();
    let progress = line.clone();
    engine.on_progress(move |step| {
        let why = match progress.is_over() {
            true => Some("its time is over".to_owned()),
            false => progress.memory.is_full(step).then(|| progress.memory.words()),
        };
        why.map(Dynamic::from)
    });
    for (name, request) in [
        ("default_open", Request::Default),
        ("default_close", Request::Default),
        ("open_domes", Request::OpenDomes),
        ("open_covers", Request::OpenCovers),
        ("unpark", Request::Unpark),
    ] {
        let line = line.clone();
        engine.register_fn(name, move || done(&line, request.clone()));
    }
    let at = line.clone();
    engine.register_fn("is_safe", move || truth(&at, Request::IsSafe));
    let at = line.clone();
    engine.register_fn("note", move |text: &str| done(&at, Request::Note(text.to_owned())));
    // The language has a sleep of its own, which nothing could interrupt: these replace it.
    let at = line.clone();
    engine.register_fn("sleep", move |seconds: FLOAT| done(&at, Request::Sleep(seconds)));
    let at = line.clone();
    engine.register_fn("sleep", move |seconds: INT| done(&at, Request::Sleep(seconds as f64)));
    let at = line.clone();
    engine.register_fn("state", move |device: &str| match asked(&at, Request::State(device.to_owned()))? {
        Reply::Fields(fields) => Ok(dynamic(&fields)),
        other => Err(unexpected(&other)),
    });
    vendor(&mut engine, line);
    engine
}

/// `command_string` and its kin, with and without `raw`, and `action` with and without parameters.
fn vendor(engine: &mut Engine, line: &ScriptLine) {
    let words = |command: &str, raw: bool| Words { command: command.to_owned(), raw };
    let at = line.clone();
    engine.register_fn("command_string", move |device: &str, command: &str| {
        text(&at, device, VendorCommand::CommandString(words(command, false)))
    });
    let at = line.clone();
    engine.register_fn("command_string", move |device: &str, command: &str, raw: bool| {
        text(&at, device, VendorCommand::CommandString(words(command, raw)))
    });
    let at = line.clone();
    engine.register_fn("command_bool", move |device: &str, command: &str| {
        flag(&at, device, VendorCommand::CommandBool(words(command, false)))
    });
    let at = line.clone();
    engine.register_fn("command_bool", move |device: &str, command: &str, raw: bool| {
        flag(&at, device, VendorCommand::CommandBool(words(command, raw)))
    });
    let at = line.clone();
    engine.register_fn("command_blind", move |device: &str, command: &str| {
        text(&at, device, VendorCommand::CommandBlind(words(command, false))).map(|_| ())
    });
    let at = line.clone();
    engine.register_fn("command_blind", move |device: &str, command: &str, raw: bool| {
        text(&at, device, VendorCommand::CommandBlind(words(command, raw))).map(|_| ())
    });
    let at = line.clone();
    engine.register_fn("action", move |device: &str, name: &str| {
        text(&at, device, VendorCommand::Action { name: name.to_owned(), parameters: String::new() })
    });
    let at = line.clone();
    engine.register_fn("action", move |device: &str, name: &str, parameters: &str| {
        let parameters = parameters.to_owned();
        text(&at, device, VendorCommand::Action { name: name.to_owned(), parameters })
    });
}

fn asked(line: &ScriptLine, request: Request) -> Fallible<Reply> {
    match line.ask(request) {
        Ok(Ok(reply)) => Ok(reply),
        Ok(Err(why)) => Err(EvalAltResult::ErrorRuntime(why.into(), Position::NONE).into()),
        // Unlike a runtime error, no `try` catches this.
        Err(Over) => Err(EvalAltResult::ErrorTerminated("its time is over".into(), Position::NONE).into()),
    }
}

fn done(line: &ScriptLine, request: Request) -> Fallible<()> {
    asked(line, request).map(|_| ())
}

fn truth(line: &ScriptLine, request: Request) -> Fallible<bool> {
    match asked(line, request)? {
        Reply::Truth(truth) => Ok(truth),
        other => Err(unexpected(&other)),
    }
}

fn text(line: &ScriptLine, device: &str, command: VendorCommand) -> Fallible<String> {
    match asked(line, Request::Vendor(device.to_owned(), command))? {
        Reply::Text(text) => Ok(text),
        other => Err(unexpected(&other)),
    }
}

/// ASCOM's truth, however a driver spells it.
fn flag(line: &ScriptLine, device: &str, command: VendorCommand) -> Fallible<bool> {
    let answer = text(line, device, command)?;
    match answer.trim().to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        _ => Err(format!("{device} answered {answer:?} to a command_bool: expected true or false").into()),
    }
}

fn unexpected(reply: &Reply) -> Box<EvalAltResult> {
    tracing::warn!(?reply, "an answer of another sort than was asked for");
    "the host gave an answer of another sort than was asked for; please report this".into()
}

/// JSON as the script sees it.
fn dynamic(value: &Value) -> Dynamic {
    match value {
        Value::Null => Dynamic::UNIT,
        Value::Bool(truth) => Dynamic::from_bool(*truth),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => Dynamic::from_int(whole),
            None => Dynamic::from_float(number.as_f64().unwrap_or(f64::NAN)),
        },
        Value::String(text) => Dynamic::from(text.clone()),
        Value::Array(items) => Dynamic::from_array(items.iter().map(dynamic).collect::<Array>()),
        Value::Object(fields) => {
            let named = fields.iter().map(|(name, field)| (name.as_str().into(), dynamic(field)));
            Dynamic::from_map(named.collect::<Map>())
        }
    }
}
