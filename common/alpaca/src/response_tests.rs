use contract::Scalar;
use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::value;

/// The expected meaning of a careless answer.
enum Meant {
    Number(f64),
    Flag(bool),
    Text(&'static str),
    /// No number, for a reason that begins so.
    NoNumber(&'static str),
    Ascom(u32, &'static str),
    Http(u16, &'static str),
    Unreadable,
    OfAnother,
    NoValue,
}
use Meant::*;

/// Reads an answer to request 1.
fn parse(status: u16, body: &[u8]) -> Result<Answer, AlpacaError> {
    super::parse(status, body, &Transactions::fresh(), 1)
}

fn holds(status: u16, body: &[u8], meant: &Meant) -> bool {
    let answer = parse(status, body);
    let value = || answer.clone().ok().and_then(|answer| answer.value);
    match meant {
        Number(expected) => value().is_some_and(|v| value::number(&v) == Ok(*expected)),
        Flag(expected) => value().is_some_and(|v| value::flag(&v) == Ok(*expected)),
        Text(expected) => value().is_some_and(|v| value::text(&v).as_deref() == Ok(*expected)),
        NoNumber(reason) => value().is_some_and(|v| value::number(&v).is_err_and(|no| no.0.starts_with(reason))),
        Ascom(code, text) => {
            matches!(&answer, Err(AlpacaError::Ascom { code: c, message }) if c == code && message == text)
        }
        Http(status, text) => {
            matches!(&answer, Err(AlpacaError::Http { status: s, body }) if s == status && body.contains(text))
        }
        OfAnother => matches!(&answer, Err(AlpacaError::Foreign { .. })),
        Unreadable => matches!(&answer, Err(AlpacaError::Protocol(_))),
        NoValue => answer.as_ref().is_ok_and(|answer| answer.value.is_none()),
    }
}

#[test]
fn what_a_sloppy_server_plainly_means_is_understood() {
    let utf16 = |text: &str, mark: [u8; 2], bytes: fn(u16) -> [u8; 2]| {
        mark.into_iter().chain(text.encode_utf16().flat_map(bytes)).collect::<Vec<u8>>()
    };
    let table: Vec<(&str, u16, Vec<u8>, Meant)> = [
        (
            "as the standard says",
            200,
            r#"{"Value":1.5,"ClientTransactionID":1,"ServerTransactionID":2,"ErrorNumber":0,"ErrorMessage":""}"#,
            Number(1.5),
        ),
        ("only a value", 200, r#"{"Value": 3}"#, Number(3.0)),
        ("transaction 0", 200, r#"{"Value":2,"ClientTransactionID":0,"ErrorNumber":0}"#, Number(2.0)),
        ("transaction as text", 200, r#"{"Value":2,"ClientTransactionID":"1","ErrorNumber":0}"#, Number(2.0)),
        ("transaction -1", 200, r#"{"Value":2,"ClientTransactionID":-1,"ErrorNumber":0}"#, OfAnother),
        ("another transaction", 200, r#"{"Value":2,"ClientTransactionID":2,"ErrorNumber":0}"#, OfAnother),
        ("another's error", 200, r#"{"ClientTransactionID":2,"ErrorNumber":1024,"ErrorMessage":"x"}"#, OfAnother),
        ("another's refusal", 500, r#"{"ClientTransactionID":2,"ErrorNumber":1024,"ErrorMessage":"x"}"#, OfAnother),
        ("a value twice", 200, r#"{"Value":2,"Value":3,"ErrorNumber":0}"#, Unreadable),
        ("a value twice, in two cases", 200, r#"{"Value":2,"value":2,"ErrorNumber":0}"#, Unreadable),
        ("half an error", 200, r#"{"Value":2,"ErrorNumber":0.5}"#, Unreadable),
        ("an error that is an object", 200, r#"{"Value":2,"ErrorNumber":{"code":1}}"#, Unreadable),
        ("a message that is an object", 200, r#"{"Value":2,"ErrorNumber":0,"ErrorMessage":{"x":1}}"#, Unreadable),
        ("an error of another form", 200, r#"{"Value":2,"ErrorNumber":0,"Error":{"code":1}}"#, Unreadable),
        ("no error of another form", 200, r#"{"Value":2,"ErrorNumber":0,"DriverException":null}"#, Number(2.0)),
        ("ErrorNumber null", 200, r#"{"Value":2,"ErrorNumber":null,"ErrorMessage":null}"#, Number(2.0)),
        ("ErrorNumber as text", 200, r#"{"Value":2,"ErrorNumber":"0","ErrorMessage":""}"#, Number(2.0)),
        ("error as text", 200, r#"{"Value":2,"ErrorNumber":"1025","ErrorMessage":"bad"}"#, Ascom(0x401, "bad")),
        ("error as hex", 200, r#"{"ErrorNumber":"0x40B","ErrorMessage":"no"}"#, Ascom(0x40B, "no")),
        ("number as text", 200, r#"{"Value":" 12.25 ","ErrorNumber":0}"#, Number(12.25)),
        ("flag as text", 200, r#"{"Value":"True"}"#, Flag(true)),
        ("flag as number", 200, r#"{"Value":0}"#, Flag(false)),
        ("Python's flag", 200, r#"{"Value": True, "ErrorNumber": 0, "ErrorMessage": None}"#, Flag(true)),
        ("NaN", 200, r#"{"Value":NaN,"ErrorNumber":0}"#, NoNumber("not a number")),
        ("Infinity", 200, r#"{"Value":-Infinity}"#, NoNumber("not a number")),
        ("nan in small letters", 200, r#"{"Value": nan}"#, NoNumber("not a number")),
        ("null", 200, r#"{"Value":null}"#, NoNumber("missing")),
        ("a text that says NaN in a message", 200, r#"{"Value":"is NaN \" ok","x":NaN}"#, Text("is NaN \" ok")),
        ("lower-case keys", 200, r#"{"value":4,"errornumber":0,"errormessage":""}"#, Number(4.0)),
        ("upper-case keys", 200, r#"{"VALUE":4,"ERRORNUMBER":0}"#, Number(4.0)),
        ("byte order mark", 200, "\u{feff}{\"Value\":4}", Number(4.0)),
        ("trailing NULs", 200, "{\"Value\":4}\0\0\0", Number(4.0)),
        ("line ends around it", 200, "\r\n {\"Value\":4}\r\n", Number(4.0)),
        ("fields nobody knows", 200, r#"{"Value":4,"Extra":{"deep":[1]},"Status":"OK"}"#, Number(4.0)),
        ("a message without an error", 200, r#"{"Value":4,"ErrorNumber":0,"ErrorMessage":"Success"}"#, Number(4.0)),
        ("an error without a number", 200, r#"{"Value":0,"ErrorMessage":"device unplugged"}"#, Unreadable),
        ("no value", 200, r#"{"ErrorNumber":0,"ErrorMessage":""}"#, NoValue),
        ("nothing at all", 200, "", NoValue),
        ("an HTML page", 200, "<html><body>It works!</body></html>", Unreadable),
        ("a list", 200, "[1,2]", Unreadable),
        ("half a body", 200, r#"{"Value":12.3,"Err"#, Unreadable),
        ("a number too large for any", 200, r#"{"Value":1e999}"#, Unreadable),
        ("not implemented", 200, r#"{"ErrorNumber":1024,"ErrorMessage":"no rotator"}"#, Ascom(0x400, "no rotator")),
        ("an HRESULT", 200, r#"{"ErrorNumber":2147746823,"ErrorMessage":"off"}"#, Ascom(0x407, "off")),
        ("a negative HRESULT", 200, r#"{"ErrorNumber":-2147220480,"ErrorMessage":"x"}"#, Ascom(0x400, "x")),
        ("HTTP 400 with its reason", 400, "Invalid device number 9", Http(400, "Invalid device number 9")),
        ("HTTP 404 page", 404, "<h1>Not Found</h1>", Http(404, "Not Found")),
        ("HTTP 500 with ASCOM JSON", 500, r#"{"ErrorNumber":1031,"ErrorMessage":"off"}"#, Ascom(0x407, "off")),
        ("HTTP 500 with JSON that is no error", 500, r#"{"Value":1}"#, Http(500, "Value")),
    ]
    .into_iter()
    .map(|(name, status, body, meant)| (name, status, body.as_bytes().to_vec(), meant))
    .chain([
        ("UTF-16", 200, utf16(r#"{"Value":4}"#, [0xFF, 0xFE], u16::to_le_bytes), Number(4.0)),
        ("UTF-16 the other way", 200, utf16(r#"{"Value":4}"#, [0xFE, 0xFF], u16::to_be_bytes), Number(4.0)),
        ("not UTF-8", 200, b"{\"Value\":\"\xE9\",\"ErrorNumber\":0}".to_vec(), Text("\u{fffd}")),
    ])
    .collect();
    assert!(table.len() >= 29);
    for (name, status, body, meant) in table {
        assert!(holds(status, &body, &meant), "{name}: {:?}", parse(status, &body));
    }
}

#[test]
fn of_an_error_in_the_servers_own_form_its_words_are_told_and_not_its_braces() {
    for (body, words) in [
        (
            r#"{"type":"about:blank","title":"Internal Server Error","status":500,"detail":"the port is gone"}"#,
            "the port is gone",
        ),
        (r#"{"message": " no such device "}"#, "no such device"),
        (r#"{"Title":"Internal Server Error","Detail":""}"#, "Internal Server Error"),
        (r#"{"code":7}"#, r#"{"code":7}"#),
    ] {
        let Err(AlpacaError::Http { status: 500, body: told }) = parse(500, body.as_bytes()) else { panic!("{body}") };
        assert_eq!(told, words, "{body}");
    }
}

#[test]
fn a_list_of_names_is_a_list() {
    let answer = parse(200, br#"{"Value":["R","G",null]}"#).unwrap().value.unwrap();
    assert!(value::list(&answer, value::text).is_err());
    assert_eq!(value::scalar(&json!(["R", 1])), Ok(Scalar::List(vec![Scalar::Text("R".to_owned()), Scalar::Int(1)])));
}

#[test]
fn errors_become_reasons_that_begin_with_their_class() {
    let reason = |status, body: &str| parse(status, body.as_bytes()).unwrap_err().no_data().0;
    assert_eq!(reason(200, r#"{"ErrorNumber":1024,"ErrorMessage":"x"}"#), "not implemented");
    assert_eq!(reason(200, r#"{"ErrorNumber":1031,"ErrorMessage":"off"}"#), "not connected: off");
    assert_eq!(reason(200, r#"{"ErrorNumber":1280,"ErrorMessage":"stuck"}"#), "ascom 0x500: stuck");
    assert_eq!(reason(503, "later"), "http 503: later");
    assert_eq!(AlpacaError::timeout(2.0).no_data().0, "timeout: no answer within 2 s");
}

/// Is this body of an answer to request 71 read as safe?
fn is_safe(status: u16, body: &[u8]) -> bool {
    let answer = parse_exactly(status, body, &Transactions::fresh(), 71);
    answer.is_ok_and(|answer| answer.value.as_ref().is_some_and(|value| value::strict_flag(value) == Ok(true)))
}

#[test]
fn a_safety_answer_is_safe_only_if_it_is_exactly_right() {
    let right = [
        r#"{"Value":true,"ClientTransactionID":71,"ServerTransactionID":9,"ErrorNumber":0,"ErrorMessage":""}"#,
        // Servers that return no id, or 0.
        r#"{"Value":true,"ErrorNumber":0,"ErrorMessage":""}"#,
        "{\r\n \"ErrorMessage\": null, \"ErrorNumber\": 0, \"ClientTransactionID\": 0, \"Value\": true\r\n}\r\n",
        r#"{"Value":true,"ClientTransactionID":71,"ErrorNumber":0,"ErrorMessage":"","DriverException":null,"Model":"x"}"#,
    ];
    for body in right {
        assert!(is_safe(200, body.as_bytes()), "{body}");
    }
    let value = |value: &str| {
        format!(
            r#"{{"Value":{value},"ClientTransactionID":71,"ServerTransactionID":9,"ErrorNumber":0,"ErrorMessage":""}}"#
        )
    };
    let with = |members: &str| format!(r#"{{"Value":true,{members}}}"#);
    let mut odd: Vec<String> = Vec::new();
    odd.extend(
        ["True", "TRUE", "\"true\"", "\"True\"", "1", "1.0", "[true]", "{\"Value\":true}", "null", "tru", "-true"]
            .map(value),
    );
    odd.extend(
        [
            r#""Value":false,"ErrorNumber":0"#,
            r#""Value":true,"ErrorNumber":0"#,
            r#""value":false,"ErrorNumber":0"#,
            r#""ErrorNumber":0,"ErrorNumber":1"#,
            r#""ErrorNumber":1,"ErrorNumber":0"#,
            r#""errornumber":0"#,
            r#""ErrorNumber":0.5"#,
            r#""ErrorNumber":0.0"#,
            r#""ErrorNumber":-1"#,
            r#""ErrorNumber":1031"#,
            r#""ErrorNumber":"0""#,
            r#""ErrorNumber":"","ErrorMessage":"""#,
            r#""ErrorNumber":false"#,
            r#""ErrorNumber":null"#,
            r#""ErrorNumber":[]"#,
            r#""ErrorNumber":{"code":0}"#,
            r#""ErrorMessage":"""#,
            r#""ErrorNumber":0,"ErrorMessage":"Sensor lost""#,
            r#""ErrorNumber":0,"ErrorMessage":{"code":1}"#,
            r#""ErrorNumber":0,"ErrorMessage":["x"]"#,
            r#""ErrorNumber":0,"ErrorMessage":7"#,
            r#""ErrorNumber":0,"Error":{"code":1031}"#,
            r#""ErrorNumber":0,"error":"timeout""#,
            r#""ErrorNumber":0,"Exception":"x""#,
            r#""ErrorNumber":0,"IsSafe":"no""#,
            r#""ErrorNumber":0,"ClientTransactionID":70"#,
            r#""ErrorNumber":0,"ClientTransactionID":-71"#,
            r#""ErrorNumber":0,"ClientTransactionID":-1"#,
            r#""ErrorNumber":0,"ClientTransactionID":71.5"#,
            r#""ErrorNumber":0,"ClientTransactionID":"71""#,
            r#""ErrorNumber":0,"ClientTransactionID":"x""#,
            r#""ErrorNumber":0,"ClientTransactionID":4294967367"#,
            r#""ErrorNumber":0,"clienttransactionid":71"#,
            r#""ErrorNumber":0,"ClientTransactionID":71,"ClientTransactionID":70"#,
            r#""ErrorNumber":0,"ServerTransactionID":"x""#,
        ]
        .map(with),
    );
    odd.extend([r#"{"value":true,"ErrorNumber":0}"#.to_owned(), "true".to_owned(), format!("[{}]", value("true"))]);
    odd.extend([format!("{}x", value("true")), format!("{}{}", value("true"), value("false"))]);
    odd.extend([
        format!("\u{feff}{}", value("true")),
        format!("{}\0", value("true")),
        format!("/**/{}", value("true")),
    ]);
    for body in odd {
        assert!(!is_safe(200, body.as_bytes()), "{body}");
    }
    for status in [201, 203, 204, 206, 304, 400, 500] {
        assert!(!is_safe(status, right[0].as_bytes()), "HTTP {status}");
    }
}

#[test]
fn a_monitor_that_returned_ids_and_then_none_is_not_believed() {
    let transactions = Transactions::fresh();
    let body = |id: u32| format!(r#"{{"Value":true,"ClientTransactionID":{id},"ErrorNumber":0,"ErrorMessage":""}}"#);
    let reads = |id: u32, asked: u32| parse_exactly(200, body(id).as_bytes(), &transactions, asked).is_ok();
    assert!(reads(0, 1) && reads(0, 2), "this server returns none");
    assert!(reads(3, 3));
    assert!(!reads(0, 4), "and now it does");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(status in 100_u16..600, body in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = parse(status, &body);
    }

    #[test]
    fn no_text_makes_it_panic(body in "[\\[\\]{}\",:NaIinfty\\\\0-9é +-]{0,80}") {
        let _ = parse(200, body.as_bytes());
    }

    #[test]
    fn only_json_true_is_ever_read_as_safe(body in "\\{\"Value\": ?[a-zA-Z0-9\".]{0,8}\\}") {
        let body = body.replacen('}', r#","ErrorNumber":0}"#, 1);
        if let Ok(Answer { value: Some(value) }) = parse_exactly(200, body.as_bytes(), &Transactions::fresh(), 1)
            && value::strict_flag(&value) == Ok(true)
        {
            prop_assert!(body.contains("true") && !body.contains("\"true"));
        }
    }
}
