//! How long a frame takes from its file to a JPEG: `bench_picture FILE RUNS [zscale]` prints the milliseconds of each run: all, of
//! it reading while the frame is made small, and stretching with encoding; and the bytes of the JPEG. `tests/bench/preview.py` uses it.

use std::io;
use std::time::Instant;

use picture::jpeg::encode;
use picture::shrink::{block, shrink_rows};
use picture::stretch::{Curve, Look};

fn main() -> io::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, runs, ..] = words.as_slice() else { return Err(io::Error::other("expected FILE RUNS [zscale]")) };
    let runs: u32 = runs.parse().map_err(io::Error::other)?;
    let curve = if words.get(2).is_some_and(|word| word == "zscale") { Curve::Zscale } else { Curve::Asinh };
    for _ in 0..runs {
        let began = Instant::now();
        let mut rows =
            fits::rows::Rows::open(file.as_ref()).map_err(io::Error::other)?.ok_or(io::ErrorKind::InvalidData)?;
        let (width, height) = (rows.width_px, rows.height_px);
        let block = block(width, height, 1024);
        let small =
            shrink_rows((width, height), block, |most, into| rows.read(most, into)).map_err(io::Error::other)?;
        let shrunk = began.elapsed();
        let jpeg = encode(&small, Look { curve, ..Look::default() }).map_err(io::Error::other)?;
        let all = began.elapsed();
        let ms = |time: std::time::Duration| time.as_secs_f64() * 1000.0;
        println!("{:.3} {:.3} {:.3} {}", ms(all), ms(shrunk), ms(all - shrunk), jpeg.len());
    }
    Ok(())
}
