//! Screened Poisson solver: the smooth field with prescribed differences, on a grid (Pérez, Gangnet and Blake
//! 2003, "Poisson image editing"; Bhat et al. 2008, "Fourier analysis of the 2D screened Poisson equation").
//!
//! Multigrid: coarse grids correct low frequencies, and a few Gauss-Seidel sweeps per level the rest.

/// Three channels, padded to four for SIMD.
pub type ChannelValues = [f32; 4];

/// Number of multigrid cycles, Gauss-Seidel sweeps before and after each coarse correction, and sweeps at the
/// coarsest level.
const CYCLE_COUNT: usize = 2;
const SWEEPS: usize = 2;
const COARSEST_SWEEPS: usize = 8;
/// Grids are coarsened until the reach is at most this number of cells.
const COARSEST_REACH: f32 = 1.5;

/// Least-squares problem: minimise Σ w (f(a) − f(b) − d)² over neighbours, plus Σ pull f² over cells.
#[derive(Debug)]
pub struct PoissonGrid {
    /// Cells per row, including a border cell without weight on each side; a border row is also above and
    /// below.
    stride: usize,
    rows: usize,
    /// Weight of the difference to the next cell in the row, and to the cell below.
    right: Vec<f32>,
    down: Vec<f32>,
    /// Sum of w d over the cell's neighbours.
    wanted: Vec<ChannelValues>,
    pull: Vec<f32>,
    reciprocals: Vec<f32>,
}

impl PoissonGrid {
    /// Create a grid without any weights.
    pub fn new(width: usize, height: usize) -> Self {
        let (stride, rows) = (width + 2, height + 2);
        let cells = stride * rows;
        Self {
            stride,
            rows,
            right: vec![0.0; cells],
            down: vec![0.0; cells],
            wanted: vec![[0.0; 4]; cells],
            pull: vec![0.0; cells],
            reciprocals: vec![0.0; cells],
        }
    }

    /// Return the index of a cell.
    #[inline]
    pub fn cell(&self, x: usize, y: usize) -> usize {
        (y + 1) * self.stride + x + 1
    }

    /// Set the weight that pulls a cell to zero.
    #[inline]
    pub fn set_screening(&mut self, cell: usize, weight: f32) {
        self.pull[cell] = weight;
    }

    /// Prescribe the difference of a cell minus the next cell in its row.
    #[inline]
    pub fn prescribe_right(&mut self, cell: usize, difference: &ChannelValues) {
        self.right[cell] = 1.0;
        self.prescribe(cell, cell + 1, difference);
    }

    /// Prescribe the difference of a cell minus the cell below.
    #[inline]
    pub fn prescribe_down(&mut self, cell: usize, difference: &ChannelValues) {
        self.down[cell] = 1.0;
        self.prescribe(cell, cell + self.stride, difference);
    }

    fn prescribe(&mut self, a: usize, b: usize, difference: &ChannelValues) {
        self.wanted[a] = std::array::from_fn(|k| self.wanted[a][k] + difference[k]);
        self.wanted[b] = std::array::from_fn(|k| self.wanted[b][k] - difference[k]);
    }

    /// Solve for the field at each cell. `reach` is the decay length of a difference in cells: √(weight /
    /// pull).
    pub fn solve(&mut self, reach: f32) -> Vec<ChannelValues> {
        self.update_reciprocals();
        let mut coarser: Vec<Self> = vec![];
        let mut felt = reach;
        while felt > COARSEST_REACH {
            coarser.push(coarser.last().unwrap_or(self).coarsen());
            felt *= 0.5;
        }
        let mut field = vec![[0.0; 4]; self.wanted.len()];
        for _ in 0..CYCLE_COUNT {
            self.run_cycle(&mut field, &mut coarser);
        }
        field
    }

    /// Run one multigrid cycle on a field.
    fn run_cycle(&self, field: &mut [ChannelValues], coarser: &mut [Self]) {
        self.relax(field, SWEEPS);
        let Some((coarse, still_coarser)) = coarser.split_first_mut() else {
            self.relax(field, COARSEST_SWEEPS);
            return;
        };
        coarse.wanted.fill([0.0; 4]);
        for (cell, above) in self.coarse_cells(coarse) {
            let missing = self.residual(field, cell);
            coarse.wanted[above] = std::array::from_fn(|k| coarse.wanted[above][k] + missing[k]);
        }
        let mut more = vec![[0.0; 4]; coarse.wanted.len()];
        coarse.run_cycle(&mut more, still_coarser);
        for (cell, above) in self.coarse_cells(coarse) {
            if self.pull[cell] > 0.0 {
                field[cell] = std::array::from_fn(|k| field[cell][k] + more[above][k]);
            }
        }
        self.relax(field, SWEEPS);
    }

    /// Iterate over all cells, each with its coarse cell.
    fn coarse_cells(&self, coarse: &Self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (stride, rows, above) = (self.stride, self.rows, coarse.stride);
        (1..rows - 1).flat_map(move |row| {
            (1..stride - 1)
                .map(move |column| (row * stride + column, row.div_ceil(2) * above + column.div_ceil(2)))
        })
    }

    /// Create the grid of half resolution, without prescribed differences. Four cells become one; the weight
    /// of a difference is halved because the distance doubles.
    fn coarsen(&self) -> Self {
        let [width, height] = [self.stride, self.rows].map(|size| (size - 2).div_ceil(2));
        let mut coarse = Self::new(width, height);
        for (cell, above) in self.coarse_cells(&coarse) {
            coarse.pull[above] += self.pull[cell];
            let [row, column] = [cell / self.stride, cell % self.stride];
            coarse.right[above] += if column % 2 == 0 { 0.5 * self.right[cell] } else { 0.0 };
            coarse.down[above] += if row % 2 == 0 { 0.5 * self.down[cell] } else { 0.0 };
        }
        coarse.update_reciprocals();
        coarse
    }

    /// Compute the residual of a cell.
    #[inline(always)]
    fn residual(&self, field: &[ChannelValues], cell: usize) -> ChannelValues {
        let here = field[cell];
        let sides = [
            (self.right[cell], cell + 1),
            (self.right[cell - 1], cell - 1),
            (self.down[cell], cell + self.stride),
            (self.down[cell - self.stride], cell - self.stride),
        ];
        let mut missing = self.wanted[cell];
        for k in 0..4 {
            missing[k] -= self.pull[cell] * here[k];
            for (weight, side) in sides {
                missing[k] += weight * (field[side][k] - here[k]);
            }
        }
        missing
    }

    /// Run Gauss-Seidel sweeps, alternately forwards and backwards.
    fn relax(&self, field: &mut [ChannelValues], sweeps: usize) {
        for sweep in 0..sweeps {
            for i in 1..self.rows - 1 {
                let is_forwards = sweep % 2 == 0;
                let row = if is_forwards { i } else { self.rows - 1 - i };
                let (before, from) = field.split_at_mut(row * self.stride);
                let (here, after) = from.split_at_mut(self.stride);
                let sides = [&before[before.len() - self.stride..], &after[..self.stride]];
                self.relax_row(row, here, sides, is_forwards);
            }
        }
    }

    /// Update one row, given the rows above and below.
    fn relax_row(
        &self,
        row: usize,
        here: &mut [ChannelValues],
        [above, below]: [&[ChannelValues]; 2],
        is_forwards: bool,
    ) {
        let stride = self.stride;
        let right = &self.right[row * stride..][..stride];
        let down = &self.down[row * stride..][..stride];
        let up = &self.down[(row - 1) * stride..][..stride];
        let wanted = &self.wanted[row * stride..][..stride];
        let shares = &self.reciprocals[row * stride..][..stride];
        let (here, above, below) = (&mut here[..stride], &above[..stride], &below[..stride]);
        // The last value is kept in a register and added last, so that the processor need not wait for it.
        let mut last = [0.0; 4];
        let mut update = |i: usize, next: usize, weight_next: f32, weight_last: f32| {
            let [wanted, above, below, next] = [wanted[i], above[i], below[i], here[next]];
            last = std::array::from_fn(|k| {
                let others = wanted[k] + up[i] * above[k] + down[i] * below[k] + weight_next * next[k];
                shares[i] * (others + weight_last * last[k])
            });
            here[i] = last;
        };
        if is_forwards {
            for i in 1..stride - 1 {
                update(i, i + 1, right[i], right[i - 1]);
            }
        } else {
            for i in (1..stride - 1).rev() {
                update(i, i - 1, right[i - 1], right[i]);
            }
        }
    }

    /// Precompute the reciprocal of the total weight at each cell; 0 for cells without pull, which stay at
    /// zero.
    fn update_reciprocals(&mut self) {
        for cell in self.stride..self.pull.len() - self.stride {
            let pull = self.pull[cell];
            let (before, above) = (self.right[cell - 1], self.down[cell - self.stride]);
            let all = pull + self.right[cell] + before + self.down[cell] + above;
            self.reciprocals[cell] = if pull > 0.0 { 1.0 / all } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH: f32 = 8.0;

    /// Grid with a prescribed step of 1 between two columns.
    fn step(width: usize, height: usize, at: usize) -> PoissonGrid {
        let mut grid = PoissonGrid::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let cell = grid.cell(x, y);
                grid.set_screening(cell, 1.0 / (REACH * REACH));
                if x + 1 < width {
                    grid.prescribe_right(cell, &[if x + 1 == at { 1.0 } else { 0.0 }; 4]);
                }
                if y + 1 < height {
                    grid.prescribe_down(cell, &[0.0; 4]);
                }
            }
        }
        grid
    }

    #[test]
    fn a_step_is_met_and_fades() {
        let mut grid = step(101, 40, 51);
        let cells: Vec<usize> = (0..101).map(|x| grid.cell(x, 20)).collect();
        let field = grid.solve(REACH);
        let at = |x: usize| field[cells[x]][0];
        // In one dimension the solution is exp(−x / reach) / 2 to both sides, up to discretisation.
        for away in 0..50 {
            let wanted = 0.5 * (-(away as f32 + 0.5) / REACH).exp();
            assert!((at(50 - away) - wanted).abs() < 0.04, "{away}: {} {wanted}", at(50 - away));
            assert!(
                (at(51 + away.min(49)) + 0.5 * (-(away.min(49) as f32 + 0.5) / REACH).exp()).abs() < 0.04
            );
        }
    }

    #[test]
    fn few_sweeps_come_near_to_many() {
        let mut state = 7u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from((state >> 24) as u8) / 255.0
        };
        let (width, height) = (90, 70);
        let mut grid = PoissonGrid::new(width, height);
        // A step along a wavy line, holes, and pairs without a prescribed difference.
        let is_there = |x: usize, y: usize| x % 17 != 5 || y % 13 > 6;
        let side = |x: usize, y: usize| x as f32 > 45.0 + 10.0 * (y as f32 / 9.0).sin();
        for y in 0..height {
            for x in 0..width {
                if !is_there(x, y) {
                    continue;
                }
                let cell = grid.cell(x, y);
                grid.set_screening(cell, 1.0 / (REACH * REACH));
                for (dx, dy) in [(1, 0), (0, 1)] {
                    let (i, j) = (x + dx, y + dy);
                    if i >= width || j >= height || !is_there(i, j) || next() < 0.05 {
                        continue;
                    }
                    let difference = f32::from(side(x, y)) - f32::from(side(i, j));
                    if dx == 1 {
                        grid.prescribe_right(cell, &[difference; 4]);
                    } else {
                        grid.prescribe_down(cell, &[difference; 4]);
                    }
                }
            }
        }
        let found = grid.solve(REACH);
        let mut exact = found.clone();
        grid.relax(&mut exact, 2000);
        let apart = found.iter().zip(&exact).map(|(a, b)| (a[0] - b[0]).abs());
        let largest = exact.iter().fold(0.0f32, |most, value| most.max(value[0].abs()));
        assert!(largest > 0.4);
        assert!(apart.fold(0.0, f32::max) < 0.08);
    }

    #[test]
    fn where_nothing_is_asked_nothing_changes() {
        let mut grid = PoissonGrid::new(30, 20);
        assert!(grid.solve(REACH).iter().flatten().all(|&value| value == 0.0));
    }
}
