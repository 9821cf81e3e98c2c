//! A frame out of a file, ready to be measured.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use fits::{Header, Image};
use imaging::{Camera, Frame, Measured, Pixels, Search, is_mosaic, measure, measure_mosaic};

/// A frame and what its file says of it.
pub struct Exposure {
    /// Where it came from.
    pub file: PathBuf,
    image: Image,
    /// Whether its pixels see different colours.
    pub mosaic: bool,
}

impl Exposure {
    /// Reads the first image of a file.
    pub fn open(file: &Path) -> anyhow::Result<Self> {
        let image = fits::read(file)?;
        let mut exposure = Self { file: file.to_owned(), image, mosaic: false };
        exposure.mosaic = says_mosaic(exposure.header()) || is_mosaic(&exposure.frame()?);
        Ok(exposure)
    }

    /// What the file says.
    pub fn header(&self) -> &Header {
        &self.image.header
    }

    /// Columns, px.
    pub fn width_px(&self) -> usize {
        self.image.width_px
    }

    /// Rows, px.
    pub fn height_px(&self) -> usize {
        self.image.height_px
    }

    /// The pixels.
    pub fn frame(&self) -> anyhow::Result<Frame<'_>> {
        let pixels = match &self.image.pixels {
            fits::Pixels::U16(counts) => Pixels::U16(counts),
            fits::Pixels::F32(floats) => Pixels::F32(floats),
        };
        Ok(Frame::new(self.width_px(), self.height_px(), pixels)?)
    }

    /// What is known of the camera.
    pub fn camera(&self) -> Camera<'static> {
        // eight bits end at 255; EGAIN is e-/ADU, while GAIN is often a setting of the camera without a unit
        let max_adu = (self.image.bitpix == 8).then_some(255.0);
        let gain = self.header().number("EGAIN").ok().filter(|gain| *gain > 0.0);
        Camera { max_adu, gain_e_per_adu: gain.map_or(1.0, |gain| gain as f32), ..Camera::default() }
    }

    /// Its stars and what it is worth; places in px of the frame, also of a colour mosaic.
    pub fn measure(&self) -> anyhow::Result<Measured> {
        let search = Search::default();
        let measured = if self.mosaic {
            measure_mosaic(&self.frame()?, &self.camera(), &search)
        } else {
            measure(&self.frame()?, &self.camera(), &search)
        };
        measured.with_context(|| format!("{} cannot be measured", self.file.display()))
    }
}

/// Whether the header tells of a colour mosaic. Where the pattern begins is left to the pixels: cut and turned frames
/// keep the old word. Of binned frames it says nothing.
fn says_mosaic(header: &Header) -> bool {
    let binned = ["XBINNING", "YBINNING"].iter().any(|keyword| header.number(keyword).is_ok_and(|by| by > 1.0));
    let is_pattern = |word: &str| ["RGGB", "BGGR", "GRBG", "GBRG"].contains(&word.trim().to_ascii_uppercase().as_str());
    !binned && ["BAYERPAT", "COLORTYP", "FILTER"].iter().any(|keyword| header.text(keyword).is_ok_and(is_pattern))
}
