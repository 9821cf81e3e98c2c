//! A dark that is taken off the frames of one row before they are measured, for cameras whose hot pixels pass for
//! stars.
//!
//! Only what stands out of the dark is taken off, not its level: bias and sky keep their sum, and saturation its place.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use contract::device::camera::Frame;
use imaging::Camera;

use super::looked::Fetched;
use super::measure::{self, Plane};

/// Largest count of 16 bits, where the camera does not report its own.
const MOST_ADU: f32 = 65_535.0;

/// What stands out of a dark.
pub struct Dark {
    row: Option<u32>,
    shape: Shape,
    /// Each pixel less the median of all, ADU.
    excess_adu: Vec<f32>,
}

/// Frames that a dark can be taken off: width, height, binning, first pixel.
type Shape = (u32, u32, u32, [u32; 2]);

fn shape(frame: &Frame) -> Shape {
    (frame.width_px, frame.height_px, frame.bin, frame.origin_px)
}

impl Dark {
    /// Of its pixels. Takes a while.
    pub fn of(fetched: &Fetched) -> Self {
        let mut excess_adu = values(&fetched.plane);
        let mut sorted: Vec<f32> = excess_adu.iter().copied().filter(|value| value.is_finite()).collect();
        let middle = sorted.len() / 2;
        let median = if sorted.is_empty() { 0.0 } else { *sorted.select_nth_unstable_by(middle, f32::total_cmp).1 };
        excess_adu.iter_mut().for_each(|value| *value = if value.is_finite() { *value - median } else { 0.0 });
        Self { row: fetched.frame.purpose.row, shape: shape(&fetched.frame), excess_adu }
    }

    fn is_for(&self, frame: &Frame) -> bool {
        let is_of_row = self.row == frame.purpose.row && measure::shows_stars(&frame.purpose.image_type);
        is_of_row && self.shape == shape(frame)
    }

    /// Saturated pixels stay saturated.
    fn taken_off(&self, camera: &Camera, plane: Plane) -> Plane {
        let light = values(&plane);
        if light.len() != self.excess_adu.len() {
            return plane;
        }
        let most_adu = camera.saturation_adu.or(camera.max_adu).unwrap_or(MOST_ADU);
        let less = |(light, excess): (f32, &f32)| if light >= most_adu { light } else { light - excess };
        Plane::Floats(light.into_iter().zip(&self.excess_adu).map(less).collect())
    }
}

fn values(plane: &Plane) -> Vec<f32> {
    match plane {
        Plane::Counts(counts) => counts.iter().map(|count| f32::from(*count)).collect(),
        Plane::Floats(floats) => floats.clone(),
    }
}

/// The darks that are in force, one per camera.
#[derive(Default)]
pub struct Darks(Mutex<HashMap<String, Arc<Dark>>>);

impl Darks {
    /// The plane of a frame, less the dark that is in force for its row.
    pub fn taken_off(&self, frame: &Frame, camera: &Camera, plane: Plane) -> Plane {
        let dark = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&frame.camera).cloned();
        match dark.filter(|dark| dark.is_for(frame)) {
            Some(dark) => dark.taken_off(camera, plane),
            None => plane,
        }
    }

    /// Takes a dark off the frames of its row, until what this returns is dropped.
    pub fn put(&self, camera: &str, dark: Dark) -> InForce<'_> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(camera.to_owned(), Arc::new(dark));
        InForce { darks: self, camera: camera.to_owned() }
    }
}

/// The dark is taken off until this is dropped.
pub struct InForce<'a> {
    darks: &'a Darks,
    camera: String,
}

impl Drop for InForce<'_> {
    fn drop(&mut self) {
        self.darks.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.camera);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{drawn, frame};
    use super::*;

    const HOT: [usize; 3] = [5_000, 20_123, 40_007];

    fn framed(image_type: &str, row: u32, pixels: Vec<u16>) -> Fetched {
        let mut frame = Frame { width_px: 300, height_px: 200, ..frame("f") };
        (frame.purpose.image_type, frame.purpose.row) = (image_type.to_owned(), Some(row));
        Fetched { frame, plane: Plane::Counts(pixels), camera: Camera::default() }
    }

    fn with_hot_pixels(mut pixels: Vec<u16>) -> Vec<u16> {
        HOT.iter().for_each(|at| pixels[*at] += 5_000);
        pixels
    }

    #[test]
    fn hot_pixels_go_and_level_and_saturation_stay() {
        let dark = Dark::of(&framed("Dark Frame", 3, with_hot_pixels(vec![300; 60_000])));
        let mut sky = drawn(300, 200, 3.0, 20);
        sky[77] = 65_535;
        let light = framed("Light Frame", 3, with_hot_pixels(sky.clone()));
        let darks = Darks::default();
        let in_force = darks.put("cam", dark);
        let plane = |row, pixels: Vec<u16>| {
            let Fetched { frame, plane, camera } = framed("Light Frame", row, pixels);
            values(&darks.taken_off(&frame, &camera, plane))
        };
        let Plane::Counts(counts) = light.plane else { panic!("counts") };
        let as_drawn: Vec<f32> = sky.iter().map(|count| f32::from(*count)).collect();
        assert_eq!(plane(3, counts.clone()), as_drawn);
        assert_ne!(plane(4, counts.clone()), as_drawn, "another row asked for none");
        drop(in_force);
        assert_ne!(plane(3, counts), as_drawn, "the row is over");
    }

    #[test]
    fn a_dark_of_another_shape_is_left_alone() {
        let darks = Darks::default();
        let _in_force = darks.put("cam", Dark::of(&framed("Dark Frame", 3, vec![300; 60_000])));
        let Fetched { mut frame, plane, camera } = framed("Light Frame", 3, vec![1_000; 60_000]);
        frame.bin = 2;
        assert!(matches!(darks.taken_off(&frame, &camera, plane), Plane::Counts(_)));
        let short = framed("Light Frame", 3, vec![1_000; 10]);
        assert!(matches!(darks.taken_off(&short.frame, &camera, short.plane), Plane::Counts(_)));
    }
}
