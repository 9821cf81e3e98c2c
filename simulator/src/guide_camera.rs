//! The guide scope: the scene of its camera in place of the main camera's.

use sky::Tangent;
use units::Angle;

use crate::options::GuideCameraOptions;
use crate::scene::{Light, Pointing, Scene};

/// The observatory as the guide camera finds it. It stands on the same mount, so it follows each of its errors, and
/// turns with the tube between the sides of the pier; filter, focuser, rotator and cover are the main camera's.
pub fn scene(options: &GuideCameraOptions, main: Scene, dome_open: f64) -> Scene {
    let [east, north] = options.offset_arcmin.map(|arcmin| Angle::from_degrees(arcmin / 60.0));
    let turned = if main.pointing.pier_west { -1.0 } else { 1.0 };
    let icrs = Tangent::new(main.pointing.icrs).unproject(east * turned, north * turned);
    let half_turn = Angle::from_degrees(if main.pointing.pier_west { 180.0 } else { 0.0 });
    Scene {
        pointing: Pointing { icrs, horizontal: main.observer.to_horizontal(&icrs), ..main.pointing },
        light: Light {
            open: dome_open * main.light.slit_free,
            panel_e_per_s: 0.0,
            transmission: 1.0,
            defocus_steps: 0.0,
            position_angle: (options.camera.position_angle + half_turn).wrapped_positive(),
            ..main.light
        },
        ..main
    }
}
