//! Whatever the configuration and the header table hold: a checked value or a message; never a panic.

#[path = "../../../tests/fuzz/spoilt.rs"]
mod spoilt;

use std::path::Path;

use proptest::prelude::*;

use crate::header::{DEFAULT_CSV, HeaderTable};
use crate::parse;

const TOML: &[&str] = &[
    r#"
[observatory]
site = "paranal"
telescope = "io"
latitude_deg = -24.6
longitude_deg = -70.4
elevation_m = 2500
[safety]
sun_altitude_max_deg = -6.0
[[telescope]]
name = "mount"
server = "10.0.0.1:11111"
limits = { altitude_min_deg = 20.0, meridian_past_min = 15.0 }
[[camera]]
name = "cam"
server = "10.0.0.1:11111"
temperature_c = -30
telescope = "mount"
[[observingconditions]]
name = "wx"
server = "a:1"
limit = [{ parameter = "Humidity", upper = 80.0, dwell_min = 5.0 }]
"#,
    r#"
[observatory]
site = "s"
telescope = "t"
latitude_deg = 1
longitude_deg = 2
elevation_m = 3
[folders]
data = "d"
[bus]
multicast = false
listen = ["tcp/127.0.0.1:0"]
[[dome]]
name = "dome"
server = "a:1"
permit_valid_s = 10.0
close_with_mount = "alongside"
[[safetymonitor]]
name = "m"
server = "a:1"
dwell_min = 0.5
"#,
];

const TOML_WORDS: &[&str] = &[
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "=",
    "\"",
    "'",
    "\"\"\"",
    "'''",
    "#",
    ".",
    ",",
    "\n",
    "\r",
    "\\",
    "\\u0000",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "99999999999999999999",
    "-1",
    "0",
    "true",
    "1979-05-27T07:32:00Z",
    "a.b.c",
    "[camera]",
    "[[camera]]",
    "name = ",
    "é",
    "\0",
];

const CSV: &[&str] = &[
    DEFAULT_CSV,
    "header,dtype,fixed,device_type,device_command,comment\nA,str,true,static,x,\"a, \"\"quoted\"\" comment\"\n\
     AIRMASS,float,false,astra,,\nRA,float,false,Telescope,RightAscension,h\nPROG,str,1,action_metadata,program,\n",
    "comment;header\n",
];

const CSV_WORDS: &[&str] = &[
    ",",
    "\"",
    "\"\"",
    "\n",
    "\r\n",
    "\r",
    ";",
    "\t",
    "header",
    "dtype",
    "static",
    "astra",
    "Telescope",
    "true",
    "2",
    "\u{feff}",
    "\0",
    "é",
    "AAAAAAAAA",
    ",,,,,",
    "#",
];

proptest! {
    #![proptest_config(spoilt::config(1000))]

    #[test]
    fn any_text_is_a_configuration_or_refused_with_a_reason(text in spoilt::spoilt(TOML, TOML_WORDS)) {
        match parse(&text, Path::new("/site")) {
            Ok(config) => {
                prop_assert!((-90.0..=90.0).contains(&config.place.latitude_deg));
                let devices = config.devices();
                let names: std::collections::BTreeSet<_> =
                    devices.iter().map(|(kind, common)| (kind.word(), common.name.as_str())).collect();
                prop_assert_eq!(names.len(), devices.len(), "two devices of one kind have one name");
            }
            Err(why) => prop_assert!(!why.to_string().is_empty()),
        }
    }
}

proptest! {
    #![proptest_config(spoilt::config(2000))]

    #[test]
    fn any_text_is_a_header_table_or_refused_with_its_line(text in spoilt::spoilt(CSV, CSV_WORDS)) {
        match text.parse::<HeaderTable>() {
            Ok(table) => {
                prop_assert!(table.rows.len() <= text.len());
                for row in &table.rows {
                    prop_assert!((1..=8).contains(&row.keyword.len()) && row.keyword.is_ascii(), "{row:?}");
                }
            }
            Err(why) => prop_assert!(why.to_string().contains("line "), "{why}"),
        }
    }
}

#[test]
fn a_text_too_large_is_refused_before_it_is_read() {
    let large = "#".repeat((1 << 20) + 1);
    assert!(parse(&large, Path::new("/")).unwrap_err().to_string().contains("at most 1048576"));
    assert!(large.parse::<HeaderTable>().unwrap_err().to_string().contains("at most 1048576"));
}

#[test]
fn the_texts_that_are_spoilt_are_good_ones() {
    for text in TOML {
        parse(text, Path::new("/site")).unwrap();
    }
    for text in &CSV[..2] {
        text.parse::<HeaderTable>().unwrap();
    }
}
