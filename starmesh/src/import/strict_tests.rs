//! Values that are written in another way than the predecessor's template writes them: read as they are meant, or
//! listed.

use super::entry::Notes;
use super::*;

/// The result of reading a configuration, and the notes.
fn read(config: &str) -> (Vec<Block>, Notes) {
    let mut notes = Notes::default();
    let node = salvage::read(config, &mut notes).unwrap();
    let (blocks, _) = devices_of(&node, &mut notes).unwrap();
    (blocks, notes)
}

fn assert_note(notes: &Notes, line: usize, words: &str) {
    assert!(notes.lines.iter().any(|(at, what)| *at == line && what.contains(words)), "{line} {words}: {notes:#?}");
}

#[test]
fn no_other_device_is_ever_commanded_because_a_number_was_written_otherwise() {
    let camera = |number: &str| {
        let text = format!(
            "Telescope: [{{device_name: m, ip: \"h:1\", device_number: 0}}]\nCamera:\n  - device_name: c\n    ip: h:1\n    {number}\n"
        );
        let (blocks, notes) = read(&text);
        (blocks.into_iter().find(|block| block.kind == Kind::Camera).map(|block| block.number), notes)
    };
    for written in [
        "device_number: \"1\"",
        "device_number: 1",
        "device_number: 1.0",
        "device_number: ' 1 '",
        "device_number: 0x1",
        "device_number: !!str 1",
    ] {
        let (number, notes) = camera(written);
        assert_eq!(number, Some(1), "{written}: {notes:?}");
    }
    for written in [
        "device_number: one",
        "device_number: -1",
        "device_number: 1.5",
        "device_number: [1]",
        "device_number: {a: 1}",
        "device_number: true",
        "device_number: 1e12",
        "device_number:",
        "device_number: ~",
        "device_number: 1\n    device_number: 2",
    ] {
        let (number, notes) = camera(written);
        assert_eq!(number, None, "{written}");
        assert_note(&notes, 3, "THE DEVICE IS LEFT OUT");
    }
    let (number, notes) = camera("temperature: 1");
    assert_eq!(number, Some(0));
    assert_note(&notes, 3, "device_number is not set; 0 is taken");
}

#[test]
fn one_value_that_is_not_taken_costs_nothing_else() {
    let (blocks, notes) = read(
        "Telescope:\n  - {device_name: m, ip: \"h:1\", device_number: 0, meridian_flip: \"yes\", meridian_flip_min: 500, connectable: \"false\",\n    \
         pointing_threshold: 900, settle_factor: -1, polling_interval: 0}\n\
         Camera: [{device_name: c, ip: \"h:1\", device_number: 0, temperature: [-30], flats: {target_adu: -5, bias_offset: 300}}]\n\
         Focuser: [{device_name: f, ip: \"h:1\", device_number: 0, focus_position: 10.5, settle_time: ~}]\n\
         Dome: [{device_name: d, ip: \"no port\", device_number: 0}]\n\
         SafetyMonitor: [{device_name: s, ip: \"h:1\", device_number: 0, max_safe_duration: -3}]\n\
         ObservingConditions:\n  - device_name: w\n    ip: h:1\n    device_number: 0\n    closing_limits:\n      Humidity: [{upper: 80, max_safe_duration: 5}]\n      \
         Gloom: [{upper: 3, max_safe_duration: 5}]\n      WindSpeed: [{upper: high}, {upper: 10, lower: 20, max_safe_duration: 1}]\n\
         Misc: {filename_templates: {object: 5}}\n",
    );
    let text: String = blocks.iter().map(|block| block.text(&[])).collect();
    for words in
        ["meridian_flip = true", "connect = false", "flats.bias_adu", "parameter = \"Humidity\"", "dwell_min = 30"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    for left in [
        "meridian_flip_min",
        "period_s",
        "settle_factor",
        "target_adu",
        "best_position",
        "Gloom",
        "[[dome]]",
        "temperature",
    ] {
        assert!(!text.contains(left), "{left}: {text}");
    }
    assert_note(&notes, 2, "\"yes\" is taken for true");
    assert_note(&notes, 2, "meridian_flip_min = 500");
    assert_note(&notes, 3, "settle_factor = -1");
    assert_note(&notes, 3, "period_s = 0");
    assert_note(&notes, 4, "target_adu = -5.0");
    assert_note(&notes, 4, "temperature: expected a number, found a list of 1");
    assert_note(&notes, 5, "focus_position: expected a whole number, found 10.5");
    assert_note(&notes, 5, "settle_time: has no value");
    assert_note(&notes, 6, "THE DEVICE IS LEFT OUT");
    assert_note(&notes, 7, "Astra's 30 min are taken");
    assert_note(&notes, 14, "THIS LIMIT DOES NOT CLOSE THE DOME");
    assert_note(&notes, 15, "THIS LIMIT DOES NOT CLOSE THE DOME");
}

#[test]
fn two_devices_of_one_name_and_pairs_that_are_not_there_are_reported() {
    let (blocks, mut notes) = read(
        "Camera:\n  - {device_name: c, ip: \"h:1\", device_number: 0, paired_devices: {Focuser: g}}\n  - {device_name: c, ip: \"h:1\", device_number: 1}\n\
         Focuser: [{device_name: f, ip: \"h:1\", device_number: 0}]\nFilterWheel: [{device_name: w, ip: \"h:1\", device_number: 0}]\n",
    );
    assert_note(&notes, 3, "a second one of this name");
    let files = telescopes::distribute(blocks, "site", &mut notes);
    let about = file::About {
        site: "site",
        location: None,
        templates: &[],
        catalogue: None,
        header: false,
        simulator: None,
        index: 0,
    };
    let text = file::text(&files[0], &about, &mut notes);
    assert!(!text.contains("focuser ="), "{text}");
    assert_note(&notes, 2, "is paired with Focuser \"g\", which is not in this file, and works with \"f\" now");
    assert_note(&notes, 2, "names no FilterWheel");
}

#[test]
fn a_header_row_that_cannot_be_read_costs_only_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.csv");
    let table = config::header::DEFAULT_CSV.to_owned();
    let rows = table.parse::<config::header::HeaderTable>().unwrap().rows.len();
    std::fs::write(
        &path,
        table.clone() + "GOOD,str,true,static,x,\nTOOLONGNAME,str,true,static,x,\nBAD,complex,true,static,x,\n",
    )
    .unwrap();
    let mut notes = Notes::default();
    let read = read_header(&path, &mut notes).unwrap().unwrap();
    assert_eq!(read.parse::<config::header::HeaderTable>().unwrap().rows.len(), rows + 1);
    let line = table.lines().count() + 2;
    assert!(notes.lines[0].1.contains(&format!("line {line}:")), "{notes:?}");
    assert!(notes.lines[1].1.contains(&format!("line {}:", line + 1)), "{notes:?}");
    std::fs::write(&path, "a,b\n1,2\n").unwrap();
    assert_eq!(read_header(&path, &mut notes).unwrap(), None);
}

#[test]
fn a_file_name_that_no_frame_can_get_is_listed_and_the_others_stay() {
    let mut notes = Notes::default();
    let node = salvage::read(
        "Telescope: [{device_name: m, ip: \"h:1\", device_number: 0}]\nMisc:\n  filename_templates:\n    \
         object: \"{action_date}/{object_name}_{exposure_s}.fits\"\n    flats: \"{action_date}/{night}.fits\"\n    \
         autofocus: \"../{timestamp}.fits\"\n    dark: \"{timestamp}.fits\"\n    default: \"{action_date}/{timestamp}.fits\"\n",
        &mut notes,
    )
    .unwrap();
    let (_, templates) = devices_of(&node, &mut notes).unwrap();
    assert_eq!(templates, [("default".to_owned(), "{action_date}/{timestamp}.fits".to_owned())], "{notes:?}");
    assert_note(&notes, 4, "the usual name is taken");
    assert_note(&notes, 5, "the usual name is taken");
    assert_note(&notes, 6, "leads out of the folder");
    assert_note(&notes, 7, "no frames are named by this");
}
