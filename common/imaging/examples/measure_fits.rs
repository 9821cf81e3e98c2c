//! What a FITS file shows: `cargo run -p imaging --example measure_fits -- FILE...` (plain or gzipped images).

#[path = "../tests/fits/mod.rs"]
mod fits;

use std::path::Path;

use anyhow::Result;
use imaging::{Camera, Frame, Search, measure, spread_evenly};

fn main() -> Result<()> {
    for file in std::env::args().skip(1) {
        let image = fits::read(Path::new(&file))?;
        let frame = Frame::new(image.width, image.height, image.pixels())?;
        let started = std::time::Instant::now();
        let measured = match measure(&frame, &Camera::default(), &Search::default()) {
            Ok(measured) => measured,
            Err(reason) => {
                println!("{file}: {reason}");
                continue;
            }
        };
        let took = started.elapsed().as_secs_f64() * 1e3;
        println!("{file}: {} x {} px, {took:.0} ms, {:?}", image.width, image.height, measured.quality);
        for star in spread_evenly(&measured.stars, image.width, image.height, 20) {
            let words = star.flags.words().join(" ");
            println!(
                "  x {:8.2} y {:8.2} +- {:.2} px  flux {:10.0} ADU  snr {:6.0}  fwhm {:5.2} px  e {:.2}  {words}",
                star.x_px, star.y_px, star.x_error_px, star.flux_adu, star.snr, star.fwhm_px, star.ellipticity
            );
        }
    }
    Ok(())
}
