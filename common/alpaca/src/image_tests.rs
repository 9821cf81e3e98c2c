use proptest::prelude::*;

use super::*;
use crate::image_json;

fn header(error: i32, own: i32, sent: i32, rank: i32, dimensions: [i32; 3]) -> Vec<u8> {
    let [d1, d2, d3] = dimensions;
    [1, error, 1, 1, 44, own, sent, rank, d1, d2, d3].into_iter().flat_map(i32::to_le_bytes).collect()
}

fn u16_image(width: i32, height: i32, value: impl Fn(i32, i32) -> u16) -> Vec<u8> {
    let mut body = header(0, 2, 8, 2, [width, height, 0]);
    for x in 0..width {
        for y in 0..height {
            body.extend(value(x, y).to_le_bytes());
        }
    }
    body
}

fn rows(image: &Image) -> Vec<u16> {
    image.bytes.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()
}

#[test]
fn columns_become_rows() {
    // Drawn in the order of the sensor.
    let drawn = [[1, 2, 3], [4, 5, 6]];
    let body = u16_image(3, 2, |x, y| drawn[y as usize][x as usize]);
    let image = decode(&Header::read(&body).unwrap(), &body, None).unwrap();
    assert_eq!((image.width_px, image.height_px, image.planes, image.pixel), (3, 2, 1, Pixel::U16));
    assert_eq!(rows(&image), drawn.concat());
}

#[test]
fn json_and_image_bytes_give_the_same_image() {
    let body = u16_image(3, 2, |x, y| (10 * x + y) as u16);
    let binary = decode(&Header::read(&body).unwrap(), &body, None).unwrap();
    let json = br#"{"Type":2,"Rank":2,"value":[[0,1],[10,11],[20,21]],"ErrorNumber":0}"#;
    assert_eq!(image_json::decode(json, Some(65535.0)).unwrap(), binary);
}

#[test]
fn colour_planes_follow_one_another() {
    let mut body = header(0, 1, 6, 3, [2, 1, 3]);
    body.extend([1, 2, 3, 4, 5, 6]);
    let image = decode(&Header::read(&body).unwrap(), &body, None).unwrap();
    assert_eq!(image.planes, 3);
    assert_eq!(rows(&image), [1, 4, 2, 5, 3, 6]);
}

#[test]
fn no_value_is_lost_to_a_type_that_is_too_small() {
    let int32 = |values: [i32; 2], max_adu: f64| {
        let mut body = header(0, 2, 2, 2, [1, 2, 0]);
        body.extend(values.into_iter().flat_map(i32::to_le_bytes));
        decode(&Header::read(&body).unwrap(), &body, Some(max_adu)).unwrap()
    };
    assert_eq!(int32([0, 65535], 65535.0).pixel, Pixel::U16);
    assert_eq!(int32([0, 65536], 65535.0).pixel, Pixel::I32);
    assert_eq!(int32([-1, 5], 65535.0).pixel, Pixel::I32);
    assert_eq!(int32([0, 5], 1_000_000.0).pixel, Pixel::I32);
    let mut body = header(0, 5, 5, 2, [1, 1, 0]);
    body.extend(u64::MAX.to_le_bytes());
    assert_eq!(decode(&Header::read(&body).unwrap(), &body, None).unwrap().pixel, Pixel::F64);
}

#[test]
fn a_header_that_lies_is_refused() {
    for (name, bytes) in [
        ("no pixels", header(0, 2, 8, 2, [0, 5, 0])),
        ("negative", header(0, 2, 8, 2, [-5, -5, 0])),
        ("more than any camera has", header(0, 2, 8, 2, [40_000, 40_000, 0])),
        ("product overflows", header(0, 2, 8, 3, [i32::MAX, i32::MAX, i32::MAX])),
        ("unknown type", header(0, 2, 77, 2, [5, 5, 0])),
        ("rank 4", header(0, 2, 8, 4, [5, 5, 0])),
        ("too short", vec![1, 0, 0]),
    ] {
        assert!(Header::read(&bytes).is_err(), "{name}");
    }
    let mut other_version = header(0, 2, 8, 2, [5, 5, 0]);
    other_version[0] = 2;
    assert!(Header::read(&other_version).is_err());
}

#[test]
fn an_error_in_the_image_keeps_its_number_and_words() {
    let mut body = header(0x40B, 0, 0, 0, [0, 0, 0]);
    body.extend(b"no image yet\0");
    let header = Header::read(&body).unwrap();
    assert_eq!(header.error(&body), AlpacaError::Ascom { code: 0x40B, message: "no image yet".to_owned() });
}

#[test]
fn crooked_json_images_are_refused() {
    for bad in [
        &br#"{"Value":[[1,2],[3]]}"#[..],
        br#"{"Value":[1,2]}"#,
        br#"{"Value":[[1,[2]]]}"#,
        br#"{"Value":[[[1],2]]}"#,
        br#"{"Value":[]}"#,
        br#"{"Value":[[]]}"#,
        br#"{"Value":5}"#,
        br#"{"Value":[[1,"x"]]}"#,
        br#"{}"#,
        b"<html>",
    ] {
        assert!(image_json::decode(bad, None).is_err(), "{}", String::from_utf8_lossy(bad));
    }
}

proptest! {
    #[test]
    fn every_image_comes_back_as_it_was_drawn(
        width in 1_i32..70, height in 1_i32..70, seed in any::<u16>(),
    ) {
        let drawn = |x: i32, y: i32| (x * 31 + y * 7) as u16 ^ seed;
        let body = u16_image(width, height, drawn);
        let image = decode(&Header::read(&body).unwrap(), &body, None).unwrap();
        let expected: Vec<u16> = (0..height).flat_map(|y| (0..width).map(move |x| drawn(x, y))).collect();
        prop_assert_eq!(rows(&image), expected);
    }

    #[test]
    fn a_wrong_length_is_an_error_and_never_a_panic(
        numbers in prop::collection::vec(prop_oneof![-3_i32..12, any::<i32>()], 11),
        rest in prop::collection::vec(any::<u8>(), 0..400),
        cut in 0_usize..500,
    ) {
        let mut body: Vec<u8> = numbers.into_iter().flat_map(i32::to_le_bytes).collect();
        body[0..4].copy_from_slice(&1_i32.to_le_bytes());
        body.extend(rest);
        body.truncate(cut);
        if let Ok(header) = Header::read(&body) && header.error_number == 0 {
            prop_assert_eq!(decode(&header, &body, None).is_ok(), body.len() >= header.bytes());
        }
    }

    #[test]
    fn no_json_makes_it_panic(text in "\\{\"Value\":[\\[\\]0-9,.-]{0,60}\\}") {
        let _ = image_json::decode(text.as_bytes(), None);
    }
}
