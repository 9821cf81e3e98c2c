//! All ten kinds answer, and refuse as ASCOM requires.

use serde_json::Value;
use simulator::{Kind, Simulator};

use crate::client::{Site, options};

const KINDS: [&str; 10] = [
    "telescope",
    "camera",
    "filterwheel",
    "focuser",
    "dome",
    "safetymonitor",
    "observingconditions",
    "covercalibrator",
    "switch",
    "rotator",
];

/// Properties without parameters, as the ASCOM interfaces list them.
fn properties(kind: &str) -> Vec<&'static str> {
    let names = match kind {
        "telescope" => {
            "alignmentmode altitude aperturearea aperturediameter athome atpark azimuth canfindhome canpark \
            canpulseguide cansetdeclinationrate cansetguiderates cansetpark cansetpierside cansetrightascensionrate \
            cansettracking canslew canslewaltaz canslewaltazasync canslewasync cansync cansyncaltaz canunpark \
            declination declinationrate doesrefraction equatorialsystem focallength guideratedeclination \
            guideraterightascension ispulseguiding rightascension rightascensionrate sideofpier siderealtime \
            siteelevation sitelatitude sitelongitude slewing slewsettletime tracking trackingrate trackingrates utcdate"
        }
        "camera" => {
            "binx biny camerastate cameraxsize cameraysize canabortexposure canasymmetricbin canfastreadout \
            cangetcoolerpower canpulseguide cansetccdtemperature canstopexposure ccdtemperature cooleron coolerpower \
            electronsperadu exposuremax exposuremin exposureresolution fullwellcapacity gain gainmax gainmin hasshutter \
            heatsinktemperature imageready ispulseguiding maxadu maxbinx maxbiny numx numy offset offsetmax offsetmin \
            percentcompleted pixelsizex pixelsizey readoutmode readoutmodes sensorname sensortype setccdtemperature \
            startx starty"
        }
        "filterwheel" => "focusoffsets names position",
        "focuser" => "absolute ismoving maxincrement maxstep position stepsize tempcomp tempcompavailable temperature",
        "dome" => {
            "athome atpark azimuth canfindhome canpark cansetaltitude cansetazimuth cansetpark cansetshutter \
            canslave cansyncazimuth shutterstatus slaved slewing"
        }
        "safetymonitor" => "issafe",
        "observingconditions" => {
            "averageperiod cloudcover dewpoint humidity pressure rainrate skybrightness skyquality \
            skytemperature starfwhm temperature winddirection windgust windspeed"
        }
        "covercalibrator" => "brightness calibratorchanging calibratorstate covermoving coverstate maxbrightness",
        "switch" => "maxswitch",
        "rotator" => "canreverse ismoving mechanicalposition position reverse stepsize targetposition",
        _ => unreachable!(),
    };
    names.split_whitespace().collect()
}

#[tokio::test]
async fn every_kind_answers_its_whole_property_list() {
    let site = Site::connected(options(1.0), &KINDS).await;
    for kind in KINDS {
        let common = ["connected", "description", "driverinfo", "driverversion", "interfaceversion", "name"];
        for member in properties(kind).into_iter().chain(common) {
            assert!(!site.get(kind, member).await.is_null(), "{kind} {member}");
        }
        let state = site.get(kind, "devicestate").await;
        let answer: Vec<&str> = state.as_array().unwrap().iter().map(|item| item["Name"].as_str().unwrap()).collect();
        assert!(answer.len() >= 2 && answer.contains(&"TimeStamp"), "{kind}: {answer:?}");
    }
    for (member, query) in [
        ("axisrates", "Axis=0"),
        ("canmoveaxis", "Axis=2"),
        ("destinationsideofpier", "RightAscension=2&Declination=-30"),
    ] {
        site.get("telescope", &format!("{member}?{query}")).await;
    }
    for member in ["sensordescription", "timesincelastupdate"] {
        site.get("observingconditions", &format!("{member}?SensorName=WindSpeed")).await;
    }
    for member in [
        "canwrite",
        "canasync",
        "getswitch",
        "getswitchname",
        "getswitchdescription",
        "getswitchvalue",
        "minswitchvalue",
        "maxswitchvalue",
        "switchstep",
        "statechangecomplete",
    ] {
        site.get("switch", &format!("{member}?Id=3")).await;
    }
}

#[tokio::test]
async fn an_unconnected_device_answers_not_connected() {
    let site = Site::start(options(1.0)).await;
    for kind in KINDS {
        assert_eq!(site.get(kind, "connected").await, false);
        assert_eq!(site.answer(kind, properties(kind)[0]).await["ErrorNumber"], 0x407, "{kind}");
    }
    assert_eq!(site.try_put("dome", "openshutter", "").await, (200, 0x407));
}

#[tokio::test]
async fn requests_that_make_no_sense_are_bad_requests() {
    let site = Site::connected(options(1.0), &["camera", "dome", "telescope"]).await;
    let status = async |url: String| site.http.get(url).send().await.unwrap().status().as_u16();
    assert_eq!(status(site.url("camera", "colour")).await, 400);
    assert_eq!(status(site.url("coffeemachine", "connected")).await, 400);
    assert_eq!(status(site.url("camera", "binx").replace("/0/", "/1/")).await, 400);
    assert_eq!(status(site.url("telescope", "axisrates")).await, 400);
    assert_eq!(site.try_put("dome", "slewtoazimuth", "Azimuth=north").await.0, 400);
    assert_eq!(site.try_put("dome", "slewtoazimuth", "azimuth=10").await.0, 400, "form names mind their case");
    assert_eq!(site.try_put("dome", "slewtoazimuth", "Azimuth=400").await, (200, 0x401));
    assert_eq!(site.try_put("dome", "commandstring", "Command=x&Raw=false").await, (200, 0x400));
    assert_eq!(site.try_put("dome", "action", "Action=dance&Parameters=").await, (200, 0x40C));
}

#[tokio::test]
async fn transactions_are_numbered() {
    let site = Site::start(options(1.0)).await;
    let first = site.answer("dome", "name?clientid=3&CLIENTTRANSACTIONID=77").await;
    let second = site.answer("dome", "name?ClientTransactionID=-5").await;
    assert_eq!((&first["ClientTransactionID"], &second["ClientTransactionID"]), (&77.into(), &0.into()));
    assert!(second["ServerTransactionID"].as_u64() > first["ServerTransactionID"].as_u64());
}

#[tokio::test]
async fn the_management_api_lists_ten_devices() {
    let site = Site::start(options(1.0)).await;
    let url = |path: &str| format!("http://{}/management/{path}", site.simulator.address());
    let get = async |path: &str| -> Value {
        serde_json::from_str(&site.http.get(url(path)).send().await.unwrap().text().await.unwrap()).unwrap()
    };
    assert_eq!(get("apiversions").await["Value"], serde_json::json!([1]));
    assert!(get("v1/description").await["Value"]["ServerName"].is_string());
    let devices = get("v1/configureddevices").await;
    let listed: Vec<&str> =
        devices["Value"].as_array().unwrap().iter().map(|d| d["DeviceType"].as_str().unwrap()).collect();
    assert_eq!(listed, Kind::ALL.map(Kind::ascom));
}

#[tokio::test]
async fn the_clock_is_served_with_its_speed() {
    let site = Site::start(options(120.0)).await;
    let clock = site.control("clock").await;
    assert_eq!((&clock["speed"], &clock["simulated"]), (&120.0.into(), &true.into()));
    let at: units::Utc = clock["utc"].as_str().unwrap().parse().unwrap();
    assert!(at.seconds_since("2026-11-21T03:00:00Z".parse().unwrap()) < 600.0);
    assert!(site.simulator.world().now() > at);
}

#[tokio::test]
async fn discovery_answers_when_asked_for() {
    // A free port: bound, read, and given back; another program may be quicker to take it.
    let mut tries = 0;
    let (port, simulator) = loop {
        let port = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().port();
        match Simulator::start(simulator::Options { discovery_port: Some(port), ..options(1.0) }).await {
            Ok(simulator) => break (port, simulator),
            Err(error) => assert!(tries < 20, "{error}"),
        }
        tries += 1;
    };
    let socket = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    socket.send_to(b"alpacadiscovery1", ("127.0.0.1", port)).await.unwrap();
    let mut answer = [0; 200];
    let length = socket.recv(&mut answer).await.unwrap();
    let state: Value = serde_json::from_slice(&answer[..length]).unwrap();
    assert_eq!(state["AlpacaPort"], simulator.address().port());
}

#[tokio::test]
async fn a_stopped_simulator_is_gone_for_persistent_connections_too() {
    let site = Site::start(options(1.0)).await;
    site.get("dome", "name").await;
    let url = site.url("dome", "name");
    site.simulator.stop().await;
    assert!(site.http.get(url).send().await.is_err());
}
