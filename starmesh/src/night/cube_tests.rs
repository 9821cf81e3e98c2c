//! Which frames can be one cube.

use serde_json::json;

use super::*;

/// A frame of this camera, of so many columns and rows, and this binning and filter.
fn frame(camera: &str, [width, height]: [u32; 2], bin: u32, filter: Option<&str>) -> FoundFrame {
    serde_json::from_value(json!({
        "id": "frame-1",
        "at_utc": "2026-11-21T03:00:00Z",
        "camera": camera,
        "file": "20261120/a.fits",
        "bytes": 5760,
        "header_complete": true,
        "night": "20261120",
        "filter": filter,
        "image_type": "Light Frame",
        "exposure_s": 30.0,
        "bin": bin,
        "width_px": width,
        "height_px": height,
    }))
    .unwrap()
}

#[test]
fn frames_of_one_camera_size_and_binning_are_of_one_kind_whatever_their_filters() {
    let red = || frame("main", [4, 3], 1, Some("r"));
    assert!(one_kind(&[red()]).is_ok());
    assert!(one_kind(&[red(), frame("main", [4, 3], 1, None), frame("main", [4, 3], 1, Some("g"))]).is_ok());
    for (other, words) in [
        (frame("second", [4, 3], 1, Some("r")), "1 of camera second, 4 x 3 px, binning 1"),
        (frame("main", [3, 4], 1, Some("r")), "1 of camera main, 3 x 4 px, binning 1"),
        (frame("main", [4, 3], 2, Some("r")), "1 of camera main, 4 x 3 px, binning 2"),
    ] {
        let refused = one_kind(&[red(), other, red()]).unwrap_err().to_string();
        assert!(refused.starts_with("the frames are of 2 kinds, and a cube has one: "), "{refused}");
        assert!(refused.contains(words) && refused.contains("2 of camera main, 4 x 3 px, binning 1"), "{refused}");
        assert!(refused.contains("--camera"), "{refused}");
    }
}
