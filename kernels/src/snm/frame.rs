//! Local frame of a gate, for predicting the tip of the next triangle.

/// Axes at the midpoint of an edge: along the edge, away from the known triangle, and the triangle's normal.
pub(super) struct GateFrame {
    middle: [f64; 3],
    axes: [[f64; 3]; 3],
    /// Length of the edge in grid units, at least 1.
    pub length: f64,
}

impl GateFrame {
    /// Build the frame of the edge `from` → `to` of a triangle, with its third corner `across` on the right.
    pub(super) fn new([from, to, across]: [[i32; 3]; 3]) -> Self {
        let [from, to, across] = [from, to, across].map(|p| p.map(f64::from));
        let middle = [0, 1, 2].map(|i| 0.5 * (from[i] + to[i]));
        let (along, length) = normalize(subtract(to, from));
        let back = subtract(across, middle);
        let shift = dot(back, along);
        let (away, _) = normalize([0, 1, 2].map(|i| shift * along[i] - back[i]));
        Self { middle, axes: [along, away, cross(along, away)], length }
    }

    /// Convert to frame coordinates, in edge lengths.
    pub(super) fn to_local(&self, p: [f64; 3]) -> [f64; 3] {
        let from_middle = subtract(p, self.middle);
        self.axes.map(|axis| dot(from_middle, axis) / self.length)
    }

    /// Convert frame coordinates to grid coordinates.
    pub(super) fn to_grid(&self, local: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|i| {
            let offset: f64 = (0..3).map(|k| local[k] * self.axes[k][i]).sum();
            self.middle[i] + self.length * offset
        })
    }
}

/// Sequential form of a normal distribution: coordinate i deviates by u_i + Σ below_ij u_j over j < i. The
/// u_i are independent, with the given `variances`.
pub(super) struct CovarianceFactors {
    pub below: [[f64; 3]; 3],
    pub variances: [f64; 3],
}

impl GateFrame {
    /// Factorise the covariance of independent deviations along the frame axes, given in edge lengths.
    pub(super) fn factor_covariance(&self, deviations: [f64; 3]) -> CovarianceFactors {
        let scale = deviations.map(|d| (d * self.length) * (d * self.length));
        let covariance = |i: usize, j: usize| -> f64 {
            (0..3).map(|k| scale[k] * self.axes[k][i] * self.axes[k][j]).sum()
        };
        let (mut below, mut variances) = ([[0.0; 3]; 3], [0.0; 3]);
        for i in 0..3 {
            for j in 0..i {
                let known: f64 = (0..j).map(|k| below[i][k] * below[j][k] * variances[k]).sum();
                below[i][j] = (covariance(i, j) - known) / variances[j];
            }
            let known: f64 = (0..i).map(|k| below[i][k] * below[i][k] * variances[k]).sum();
            variances[i] = (covariance(i, i) - known).max(1.0 / 16.0);
        }
        CovarianceFactors { below, variances }
    }
}

/// Normalise a vector and return its length, but at least 1.
fn normalize(v: [f64; 3]) -> ([f64; 3], f64) {
    let length = dot(v, v).sqrt().max(1.0);
    (v.map(|x| x / length), length)
}

pub(super) fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
