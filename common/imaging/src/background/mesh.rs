//! A coarse grid of values over a frame, evaluated row by row.
//!
//! Cell `(i, j)` stands at `x = (i + 1/2) width / columns - 1/2`. Between cells the Catmull-Rom cubic is used (Keys
//! 1981, IEEE Trans. ASSP 29, 1153, a = -1/2); half a cell beyond the outermost centres the grid goes on in a
//! straight line, so that a gradient is not bent at the edges.

use super::median_in_place;

/// Values on a coarse grid, smooth in between.
#[derive(Debug, Clone)]
pub struct Mesh {
    columns: usize,
    rows: usize,
    width: usize,
    height: usize,
    cells: Vec<f32>,
}

impl Mesh {
    /// A mesh over `width` x `height` px; missing cells are filled and single outliers smoothed away. None when
    /// all cells are missing.
    pub(crate) fn new(
        columns: usize,
        rows: usize,
        width: usize,
        height: usize,
        values: Vec<Option<f32>>,
    ) -> Option<Self> {
        let cells = filled(columns, &values)?;
        Some(Self { columns, rows, width, height, cells: smoothed(columns, rows, &cells) })
    }

    /// Median over the cells.
    pub fn median(&self) -> f32 {
        median_in_place(&mut self.cells.clone()).unwrap_or(f32::NAN)
    }

    /// Number of cells along x and along y.
    pub fn shape(&self) -> (usize, usize) {
        (self.columns, self.rows)
    }

    /// Value at a pixel.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        let (row, ty) = place(y, self.height, self.rows);
        let (column, tx) = place(x, self.width, self.columns);
        let along_y = |c: usize| {
            let four: [f32; 4] =
                std::array::from_fn(|n| ghost(self.rows, row - 1 + n as isize, |r| self.cells[r * self.columns + c]));
            Cubic::through(&four, -1).at(ty)
        };
        let four: [f32; 4] = std::array::from_fn(|n| ghost(self.columns, column - 1 + n as isize, along_y));
        Cubic::through(&four, -1).at(tx)
    }

    /// Adds another mesh of the same shape.
    pub(crate) fn add(&mut self, other: &Self) {
        self.cells.iter_mut().zip(&other.cells).for_each(|(mine, theirs)| *mine += theirs);
    }

    /// Writes the values of row `y` into `out`, one per column.
    pub fn row(&self, y: usize, out: &mut [f32]) {
        let line = self.line(y);
        for (run, steps) in self.runs(out.len()) {
            let cubic = Cubic::through(&line, run.cell);
            out[run.columns].iter_mut().zip(steps).for_each(|(value, t)| *value = cubic.at(t));
        }
    }

    /// How far each column lies beyond the centre of the cell before it, in cells: the same for all rows.
    pub(crate) fn steps(&self) -> Vec<f32> {
        self.runs(self.width).flat_map(|(_, steps)| steps).collect()
    }

    /// Subtracts the values of row `y` from `line`; `steps` are the mesh's own.
    pub(crate) fn subtract(&self, y: usize, steps: &[f32], line: &mut [f32]) {
        let cells = self.line(y);
        for (run, _) in self.runs(line.len()) {
            let cubic = Cubic::through(&cells, run.cell);
            let pixels = line[run.columns.clone()].iter_mut().zip(&steps[run.columns]);
            pixels.for_each(|(pixel, t)| *pixel -= cubic.at(*t));
        }
    }

    /// The columns up to `end`, cut at the centres of the cells, and how far each lies beyond the last centre.
    fn runs(&self, end: usize) -> impl Iterator<Item = (ColumnSpan, impl Iterator<Item = f32>)> {
        let step = self.columns as f32 / self.width as f32;
        let mut x = 0;
        std::iter::from_fn(move || {
            let first = x;
            let (cell, t) = (first < end).then(|| place(first, self.width, self.columns))?;
            // columns whose left neighbour is this cell; at least the present one
            let count = (((1.0 - t) / step).ceil() as usize).clamp(1, end - first);
            x += count;
            // i32: there is no vector instruction that turns usize into f32
            Some((ColumnSpan { cell, columns: first..x }, (0..count as i32).map(move |n| t + n as f32 * step)))
        })
    }

    /// The mesh cut along row `y`, with two more cells at either end.
    fn line(&self, y: usize) -> Vec<f32> {
        let (cell, t) = place(y, self.height, self.rows);
        let mut line = vec![0.0; self.columns + 4];
        for column in 0..self.columns {
            let along_y = |row: isize| ghost(self.rows, row, |r| self.cells[r * self.columns + column]);
            let four: [f32; 4] = std::array::from_fn(|n| along_y(cell - 1 + n as isize));
            line[column + 2] = Cubic::through(&four, -1).at(t);
        }
        let inner: Vec<f32> = line[2..self.columns + 2].to_vec();
        for n in [-2, -1, self.columns as isize, self.columns as isize + 1] {
            line[(n + 2) as usize] = ghost(self.columns, n, |c| inner[c]);
        }
        line
    }
}

/// The cell whose centre is at or before pixel `at`, and how far beyond it the pixel lies, in cells (0 to 1).
fn place(at: usize, length: usize, cells: usize) -> (isize, f32) {
    let u = (at as f64 + 0.5) * cells as f64 / length as f64 - 0.5;
    (u.floor() as isize, (u - u.floor()) as f32)
}

/// Value number `n`, which may lie one or two beyond the ends: the straight line through the last two.
fn ghost(count: usize, n: isize, value: impl Fn(usize) -> f32) -> f32 {
    let last = count as isize - 1;
    let line = |end: isize, inner: isize, beyond: isize| {
        let (end, inner) = (value(end as usize), value(inner as usize));
        end + beyond as f32 * (end - inner)
    };
    if n < 0 {
        line(0, 1.min(last), -n)
    } else if n > last {
        line(last, (last - 1).max(0), n - last)
    } else {
        value(n as usize)
    }
}

/// Columns between the centres of two cells.
struct ColumnSpan {
    /// The cell before them.
    cell: isize,
    columns: std::ops::Range<usize>,
}

struct Cubic([f32; 4]);

impl Cubic {
    /// Between cell `cell` and the next of a line that begins two cells before cell 0.
    fn through(line: &[f32], cell: isize) -> Self {
        let first = ((cell + 1).max(0) as usize).min(line.len() - 4);
        let [a, b, c, d] = [line[first], line[first + 1], line[first + 2], line[first + 3]];
        Self([b, 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)])
    }

    fn at(&self, t: f32) -> f32 {
        let [c0, c1, c2, c3] = self.0;
        c0 + t * (c1 + t * (c2 + t * c3))
    }
}

/// Fills missing cells with the mean of the ten nearest, weighted by the inverse distance.
fn filled(columns: usize, values: &[Option<f32>]) -> Option<Vec<f32>> {
    const NEAREST: usize = 10;
    let known: Vec<(usize, usize, f32)> =
        values.iter().enumerate().filter_map(|(n, v)| v.map(|v| (n % columns, n / columns, v))).collect();
    if known.is_empty() {
        return None;
    }
    let guess = |n: usize| {
        let (x, y) = (n % columns, n / columns);
        let mut near: Vec<(usize, f32)> =
            known.iter().map(|(i, j, v)| (i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2), *v)).collect();
        let count = NEAREST.min(near.len());
        near.select_nth_unstable_by_key(count - 1, |(squared, _)| *squared);
        let weighed = near[..count].iter().map(|(squared, v)| ((*squared as f32).sqrt().recip(), *v));
        let (sum, weight) = weighed.fold((0.0, 0.0), |(s, w), (weight, v)| (s + weight * v, w + weight));
        sum / weight
    };
    Some(values.iter().enumerate().map(|(n, value)| value.unwrap_or_else(|| guess(n))).collect())
}

/// Median over 3 x 3 cells; at an edge over the three along it, and a corner stays as it is: a window that is
/// not symmetric would bend a gradient.
fn smoothed(columns: usize, rows: usize, cells: &[f32]) -> Vec<f32> {
    let reach = |n: usize, of: usize| 1.min(n).min(of - 1 - n);
    let mut window = Vec::with_capacity(9);
    let mut out = Vec::with_capacity(cells.len());
    for row in 0..rows {
        for column in 0..columns {
            let (dx, dy) = (reach(column, columns), reach(row, rows));
            window.clear();
            for line in cells.chunks(columns).skip(row - dy).take(2 * dy + 1) {
                window.extend_from_slice(&line[column - dx..=column + dx]);
            }
            out.push(median_in_place(&mut window).unwrap_or(cells[row * columns + column]));
        }
    }
    out
}
