//! Wrong configurations, each with the line at fault and words that the message must contain.

mod foreign;

pub use foreign::FOREIGN;

/// A good file; the wrong ones differ from it in one line. Lines are counted from here.
pub const GOOD: &str = concat!(
    include_str!("../paranal.toml"),
    r#"
[safety]
sun_altitude_max_deg = -2.0

[archive]
database = "data/archive.db"

[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
limits = { altitude_min_deg = 20 }

[[camera]]
name = "main"
server = "10.0.0.5:11111"
number = 0
temperature_c = -60
telescope = "mount"

[[dome]]
name = "dome"
server = "10.0.0.5:11111"
permit_valid_s = 10

[[safetymonitor]]
name = "monitor"
server = "10.0.0.6:11111"
dwell_min = 15

[[observingconditions]]
name = "wx"
server = "10.0.0.6:11111"
limit = [
  { parameter = "Humidity", upper = 80, reopen_upper = 75 },
  { parameter = "WindSpeed", upper = 12 },
]
"#
);

/// One change of [`GOOD`]: what is replaced, by what, the line that must be named, and words that the message must contain.
pub type Wrong = (&'static str, &'static str, usize, &'static [&'static str]);

/// Changes that refuse the file.
pub const WRONG: &[Wrong] = &[
    // what is delivered and removed
    ("database = \"data/archive.db\"", "disk_warn_gb = -1", 12, &["archive.disk_warn_gb = -1", "0 to 1000000 GB"]),
    ("database = \"data/archive.db\"", "disk_warn_gb = nan", 12, &["archive.disk_warn_gb = NaN", "GB"]),
    (
        "database = \"data/archive.db\"",
        "remove_delivered_after_days = 9",
        12,
        &["without a destination", "[[delivery]]"],
    ),
    ("[[camera]]", "[[delivery]]\nname = \"a\"\n[[camera]]", 20, &["delivery \"a\"", "directory, rsync and bucket"]),
    ("[archive]", "[[delivery]]\nname = \"a\"\ndirectory = \"/a\"\nby = \"25:00\"\n[archive]", 14, &["by = \"25:00\""]),
    // numbers in the wrong unit, or none
    ("-24.6157", "-124.6157", 4, &["latitude_deg = -124.6157", "-90 to 90"]),
    ("-24.6157", "200", 4, &["latitude_deg = 200", "-90 to 90"]),
    ("-24.6157", "nan", 4, &["latitude_deg = NaN", "-90 to 90"]),
    ("-24.6157", "\"-24.6157\"", 4, &["latitude_deg", "expected a number", "leave the quotes away: -24.6157"]),
    ("-24.6157", "\"-24:36:56.5\"", 4, &["latitude_deg", "expected a number", "-24.61569"]),
    ("-24.6157", "\"24.6 S\"", 4, &["latitude_deg", "expected a number"]),
    ("-70.3976", "\"19h18m24s\"", 5, &["longitude_deg", "expected a number", "as a decimal number that is 289.60000"]),
    ("-70.3976", "-200", 5, &["longitude_deg = -200", "-180 to 360"]),
    ("-70.3976", "true", 5, &["longitude_deg = true", "expected a number", "east positive"]),
    ("2518", "2518000", 6, &["elevation_m = 2518000", "millimetres", "2518 m"]),
    ("2518", "12000", 6, &["elevation_m = 12000", "metres"]),
    ("2518", "\"2518 m\"", 6, &["elevation_m", "expected a number", "without its unit"]),
    ("= -2.0", "= 120", 9, &["safety.sun_altitude_max_deg = 120", "-90 to 90"]),
    ("= -60", "= 213", 23, &["camera \"main\": temperature_c = 213", "kelvin", "-60.15"]),
    ("= -60", "= \"cold\"", 23, &["temperature_c", "expected a number"]),
    ("upper = 80, reopen_upper = 75", "upper = 0.8", 40, &["Humidity", "upper = 0.8", "percent", "80"]),
    ("upper = 80", "upper = 800", 40, &["Humidity", "upper = 800", "0 to 105 percent"]),
    ("upper = 80", "upper = 80, lower = 90", 40, &["upper = 80 is not more than lower = 90"]),
    ("reopen_upper = 75", "reopen_upper = 95", 40, &["reopen_upper needs an upper that is not smaller"]),
    ("upper = 80, reopen_upper = 75", "reopen_upper = 75", 40, &["neither upper nor lower"]),
    ("upper = 12", "upper = 120", 41, &["WindSpeed", "upper = 120", "0 to 100 m/s"]),
    ("upper = 12", "upper = inf", 41, &["WindSpeed", "finite"]),
    ("upper = 12", "upper = 12, dwell_min = -5", 41, &["dwell_min = -5", "0 to 1440"]),
    ("upper = 12", "upper = 12, max_age_s = 0", 41, &["max_age_s = 0", "more than 0"]),
    ("upper = 12", "upper = 12, max_age_s = 3", 41, &["max_age_s = 3", "at least period_s = 5", "without a value"]),
    (
        "permit_valid_s = 10",
        "[[switch]]\nname = \"ups\"\nserver = \"10.0.0.5:11111\"\nperiod_s = 120\n\
         limit = [{ parameter = \"GetSwitchValue0\", lower = 50 }]",
        32,
        &["switch \"ups\": period_s = 120", "at most 60 s", "max_age_s of at least 120"],
    ),
    (
        "permit_valid_s = 10",
        "[[switch]]\nname = \"ups\"\nserver = \"10.0.0.5:11111\"\n\
         limit = [{ parameter = \"GetSwitchValue0\", lower = 50, possible = [100, 0] }]",
        32,
        &["GetSwitchValue0", "possible = [100, 0]", "smallest value"],
    ),
    ("upper = 12", "upper = 12, possible = [0, 100]", 41, &["WindSpeed", "limits of a switch"]),
    ("upper = 12", "upper = 12, possible = 100", 41, &["possible = 100", "two numbers"]),
    ("upper = 12", "upper = 12, of = \"max\"", 41, &["over_min"]),
    ("upper = 12", "upper = 12, of = \"mean\"", 41, &["of = \"mean\"", "\"value\" or \"max\" or \"rate\""]),
    ("\"WindSpeed\", upper = 12", "\"Temperature\", lower = 263", 41, &["Temperature", "lower = 263", "kelvin"]),
    ("\"WindSpeed\", upper = 12", "\"Pressure\", lower = 75000", 41, &["Pressure", "Pa", "750 hPa"]),
    ("\"WindSpeed\"", "\"WindSpede\"", 41, &["no such parameter", "did you mean \"WindSpeed\"?"]),
    ("dwell_min = 15", "dwell_min = -15", 34, &["safetymonitor \"monitor\": dwell_min = -15", "0 to 1440 min"]),
    ("permit_valid_s = 10", "permit_valid_s = 100", 29, &["dome \"dome\": permit_valid_s = 100", "3 to 30 s"]),
    ("permit_valid_s = 10", "travel_timeout_s = -1", 29, &["dome \"dome\": travel_timeout_s = -1"]),
    ("permit_valid_s = 10", "period_s = 0", 29, &["dome \"dome\": period_s = 0", "0.1 to 3600 s"]),
    ("permit_valid_s = 10", "period_s = nan", 29, &["period_s = NaN"]),
    ("altitude_min_deg = 20", "altitude_min_deg = 95", 17, &["limits.altitude_min_deg = 95", "-90 to 90"]),
    ("altitude_min_deg = 20", "hour_angle_max_h = 40", 17, &["limits.hour_angle_max_h = 40", "-12 to 12"]),
    (
        "limits = { altitude_min_deg = 20 }",
        "arrival_tolerance_deg = 20",
        17,
        &["telescope \"mount\": arrival_tolerance_deg = 20", "0.001 to 10 degrees"],
    ),
    (
        "permit_valid_s = 10",
        "[[rotator]]\nname = \"r\"\nserver = \"10.0.0.5:11111\"\ntolerance_deg = -1",
        32,
        &["rotator \"r\": tolerance_deg = -1", "0.001 to 10 degrees"],
    ),
    ("dwell_min = 15", "max_age_s = 0.5", 34, &["max_age_s = 0.5", "at least period_s = 1", "unsafe each time"]),
    ("dwell_min = 15\n", "\n[shared]\nmax_age_s = 0\n", 36, &["shared.max_age_s = 0", "0.1 to 3600 s"]),
    ("dwell_min = 15\n", "\n[shared]\nmax_age_s = 1e9\n", 36, &["shared.max_age_s = 1000000000", "0.1 to 3600 s"]),
    ("sun_altitude_max_deg = -2.0", "clock_offset_max_s = 0", 9, &["safety.clock_offset_max_s = 0", "0.01 to 3600 s"]),
    ("upper = 12", "upper = 12, reopen_upper = \"10 m/s\"", 41, &["reopen_upper", "without its unit"]),
    ("upper = 12", "upper = \"12 m/s\"", 41, &["upper = \"12 m/s\"", "without its unit"]),
    ("\"WindSpeed\", upper = 12", "\"SkyBrightness\", upper = -1", 41, &["upper = -1", "0 to 200000 lux"]),
    // hosts, ports, device numbers
    ("\"10.0.0.5:11111\"\nlimits", "\"\"\nlimits", 16, &["server \"\" is no host:port", "it is empty"]),
    (
        "\"10.0.0.5:11111\"\nlimits",
        "\"10.0.0.5,11111\"\nlimits",
        16,
        &["a colon stands before the port: 10.0.0.5:11111"],
    ),
    ("paranal", "Paranal 2", 2, &["site = \"Paranal 2\"", "expected small letters, digits and '-'"]),
    (
        "telescope = \"mount\"",
        "telescope = [\"mount\"]",
        24,
        &["expected a text in quotes: the name of its block in this file"],
    ),
    (
        "[[dome]]\n",
        "[dome]\nname = \"a\"\nserver = \"a:1\"\n[dome]\n",
        29,
        &["[dome] is written [[dome]], with two brackets"],
    ),
    ("\"10.0.0.5:11111\"\nlimits", "\"10.0.0.5:70000\"\nlimits", 16, &["port 70000", "1 to 65535"]),
    ("\"10.0.0.5:11111\"\nlimits", "\"10.0.0.5\"\nlimits", 16, &["no host:port", "add the port: 10.0.0.5:11111"]),
    ("\"10.0.0.5:11111\"\nlimits", "\"http://10.0.0.5:11111\"\nlimits", 16, &["leave \"http://\" away"]),
    ("\"10.0.0.5:11111\"\nlimits", "\"10.0.0.555:11111\"\nlimits", 16, &["10.0.0.555", "no address"]),
    ("\"10.0.0.5:11111\"\nlimits", "\"dome pc:11111\"\nlimits", 16, &["dome pc", "no name of a host"]),
    ("\"10.0.0.5:11111\"\nlimits", "11111\nlimits", 16, &["server = 11111", "in quotes"]),
    ("number = 0", "number = -1", 22, &["number = -1", "0 or more"]),
    ("number = 0", "number = \"1\"", 22, &["number", "whole number", "leave the quotes away: 1"]),
    ("number = 0", "number = 0.5", 22, &["number = 0.5", "whole number"]),
    // keys and words
    ("latitude_deg", "lattitude_deg", 4, &["\"lattitude_deg\"", "did you mean \"latitude_deg\"?"]),
    ("temperature_c =", "temperatur_c =", 23, &["camera \"main\"", "did you mean \"temperature_c\"?"]),
    ("permit_valid_s", "temperature_c", 29, &["dome \"dome\"", "belongs to [[camera]]"]),
    ("permit_valid_s", "parquet", 29, &["dome \"dome\"", "belongs to [archive]"]),
    ("[[camera]]", "[[camra]]", 19, &["\"camra\"", "did you mean \"camera\"?"]),
    ("[[camera]]", "[camera]", 19, &["[[camera]]", "two brackets"]),
    ("[safety]", "[[safety]]", 8, &["[safety]", "one bracket"]),
    ("site = \"paranal\"\n", "", 1, &["observatory.site is missing", "\"paranal\""]),
    ("site = \"paranal\"", "site = \"Paranal Chile\"", 2, &["observatory.site", "small letters, digits and '-'"]),
    ("name = \"main\"", "name = \"main camera\"", 20, &["name", "letters, digits"]),
    ("name = \"main\"\n", "", 19, &["camera number 1: name is missing"]),
    ("server = \"10.0.0.5:11111\"\nnumber", "number", 19, &["camera \"main\": server is missing", "10.0.0.5:11111"]),
    ("permit_valid_s = 10", "close_with_mount = \"parked\"", 29, &["\"alongside\"", "\"parked_only\""]),
    ("permit_valid_s = 10", "follow = true", 29, &["follow = true", "in quotes"]),
    ("telescope = \"mount\"", "telescope = \"mnt\"", 24, &["names no telescope", "did you mean \"mount\"?"]),
    ("telescope = \"mount\"", "connect = \"yes\"", 24, &["connect = \"yes\"", "true or false"]),
    // two of one
    (
        "telescope = \"mount\"\n",
        "telescope = \"mount\"\n\n[[camera]]\nname = \"second\"\nserver = \"10.0.0.5:11111\"\n",
        26,
        &["camera \"second\" is the same device as camera \"main\"", "number 0"],
    ),
    (
        "telescope = \"mount\"\n",
        "telescope = \"mount\"\n\n[[camera]]\nname = \"main\"\nserver = \"10.0.0.7:11111\"\n",
        27,
        &["two camera blocks are named \"main\""],
    ),
    ("elevation_m = 2518", "latitude_deg = 5", 6, &["for the second time"]),
    // lists and pairs
    ("limits = { altitude_min_deg = 20 }", "horizon = [[0, 10, 5], [90, 20]]", 17, &["horizon[0]", "two numbers"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = [[0], [90, 20]]", 17, &["horizon[0]", "two numbers"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = [[0, 10], [90, \"b\"]]", 17, &["horizon[1][1]", "a number"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = [[0, 10], [90, 95]]", 17, &["altitude 95"]),
    ("limits = { altitude_min_deg = 20 }", "horizon = 20", 17, &["horizon = 20", "pairs such as"]),
    ("limits = { altitude_min_deg = 20 }", "limits = 20", 17, &["limits = 20", "keys of its own"]),
    (
        "temperature_c = -60",
        "guide_calibration = { east_px_per_s = [1, 0, 3], north_px_per_s = [0, 1] }",
        23,
        &["guide_calibration.east_px_per_s", "two numbers"],
    ),
    ("temperature_c = -60", "flats = { target_adu = -5 }", 23, &["flats.target_adu = -5"]),
    // notation
    ("-24.6157", "", 4, &["cannot be read", "give the key a value"]),
    ("-24.6157", "-24,6157", 4, &["cannot be read", "decimals with a point"]),
    ("\"paranal\"", "paranal", 2, &["cannot be read", "in quotes"]),
    ("\"paranal\"", "\"paranal", 2, &["cannot be read", "\""]),
    ("\"paranal\"", "“paranal”", 2, &["cannot be read", "straight quotes"]),
    ("[[camera]]", "[[camera]", 19, &["cannot be read", "brackets"]),
    ("[safety]", "[web]\nlisten = \"127.0.0.1:70000\"\n[safety]", 9, &["web.listen", "0 to 65535"]),
    ("[safety]", "[web]\nlisten = \"localhost\"\n[safety]", 9, &["web.listen", "an address and a port"]),
    ("[safety]", "[web]\ncertificate = \"a.pem\"\n[safety]", 9, &["web.certificate", "web.key"]),
    ("[safety]", "[web]\ntrust_proxy = [\"proxy\"]\n[safety]", 9, &["web.trust_proxy", "10.0.0.5/32"]),
    ("[safety]", "[web]\nproxy_right = \"root\"\n[safety]", 9, &["web.proxy_right", "viewer, observer"]),
    ("[safety]", "[web]\nproxy_right = \"viewer\"\n[safety]", 9, &["web.proxy_right", "web.trust_proxy"]),
    ("[safety]", "[web]\nproxy_user_header = \"Cookie\"\n[safety]", 9, &["web.proxy_user_header", "X-Remote-User"]),
    ("[safety]", "[web]\npublic = [\"api/heartbeat\"]\n[safety]", 9, &["web.public", "/api/heartbeat"]),
    ("[safety]", "[web]\nnames = [\"https://a\"]\n[safety]", 9, &["web.names", "without port"]),
    (
        "[safety]",
        "[web]\npush_services = [\"http://a/b\"]\n[safety]",
        9,
        &["web.push_services", "scheme, host and port"],
    ),
    ("[safety]", "[web]\nrequests_per_s = 0\n[safety]", 9, &["web.requests_per_s = 0", "1 to 10000"]),
    ("[safety]", "[web]\ninsecure_open = \"yes\"\n[safety]", 9, &["web.insecure_open", "true or false"]),
    ("[safety]", "[bus]\nlisten = [\"0.0.0.0:7447\"]\n[safety]", 9, &["bus.listen", "tcp/"]),
    ("[safety]", "[bus]\nlisten = \"tcp/0.0.0.0:7447\"\n[safety]", 9, &["bus.listen", "list"]),
    ("[safety]", "[bus]\nconnect = [\"tcp/10.0.0.5:99999\"]\n[safety]", 9, &["bus.connect", "99999"]),
    ("[safety]", "[clock]\nsimulator = \"127.0.0.1:11111\"\n[safety]", 9, &["clock.simulator", "http://"]),
    ("[safety]", "[shared]\nsafetymonitor = [\"m\", \"m\"]\n[safety]", 9, &["shared.safetymonitor", "twice"]),
    ("[safety]", "[alerts]\nflood_messages = 0\n[safety]", 9, &["alerts.flood_messages"]),
    ("[safety]", "[pointing]\nattempts = 2.5\n[safety]", 9, &["pointing.attempts = 2.5", "whole number"]),
    ("[safety]", "[schedule.check]\nmoon_distance_min_deg = 500\n[safety]", 9, &["moon_distance_min_deg = 500"]),
    ("permit_valid_s = 10", "telescopes = [\"io\"]", 29, &["does not list \"callisto\""]),
    ("permit_valid_s = 10", "slit = { width_m = 1, radius_m = -2 }", 29, &["slit.radius_m = -2"]),
    ("permit_valid_s = 10", "watchdog_s = 1", 29, &["watchdog_s = 1", "4 to 3600 s"]),
];

/// The file with one change.
pub fn changed((from, to, ..): &Wrong) -> String {
    assert!(GOOD.contains(from), "{from:?} does not stand in the good file");
    GOOD.replacen(from, to, 1)
}
