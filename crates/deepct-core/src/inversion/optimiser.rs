//! Bounded quasi-Newton minimisation: limited-memory BFGS on the variables that are free,
//! searched along the path that the bounds bend.
//!
//! A variable is free unless it stands at a bound and the gradient pushes it outwards
//! (Bertsekas 1982, "Projected Newton methods for optimization problems with simple
//! constraints"). On the free ones the direction is that of the two-loop recursion
//! (Nocedal 1980) over the last steps, each restricted to them, around what the function
//! itself knows of its second derivatives ([`Function::preconditioned`]). The step is projected onto
//! the bounds and accepted when it decreases the value enough (Armijo) and the slope along
//! it has flattened (weak Wolfe): values may cost seconds, so that the first try is taken
//! where it can be.

use crate::error::Result;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A smooth function of many variables.
pub trait Function {
    /// The value at `x`.
    ///
    /// # Errors
    /// Those of the function.
    fn value(&mut self, x: &[f64]) -> Result<f64>;

    /// The derivatives at the point of the last [`Function::value`].
    ///
    /// # Errors
    /// Those of the function.
    fn gradient(&mut self) -> Result<Vec<f64>>;

    /// The inverse of what the second derivatives at `x` are thought to be, but for a factor,
    /// times a vector, among the variables that are free; the vector is 0 at all others. A
    /// function that knows nothing gives the vector back.
    fn preconditioned(&self, _x: &[f64], vector: Vec<f64>, _free: &[bool]) -> Vec<f64> {
        vector
    }
}

/// The lowest and the highest value of each variable; may be infinite.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    /// Lowest values.
    pub lower: Vec<f64>,
    /// Highest values.
    pub upper: Vec<f64>,
}

impl Bounds {
    fn clamp(&self, index: usize, value: f64) -> f64 {
        value.max(self.lower[index]).min(self.upper[index])
    }
}

/// Where a minimisation stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// The variables.
    pub x: Vec<f64>,
    /// The value there.
    pub value: f64,
    /// The derivatives there.
    pub gradient: Vec<f64>,
}

/// A step, and how the gradient changed over it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Change of the variables.
    pub step: Vec<f64>,
    /// Change of the gradient.
    pub change: Vec<f64>,
}

/// How [`Minimiser::step`] searches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MinimiserSettings {
    /// Steps that are remembered.
    pub memory: usize,
    /// The largest change of a variable in the first try of a step that no memory guides.
    pub first_change: f64,
    /// The most values that one step may ask for.
    pub values: usize,
}

impl Default for MinimiserSettings {
    fn default() -> Self {
        Self { memory: 10, first_change: 1.0, values: 12 }
    }
}

/// Share of the decrease that the slope promises which a step must reach.
const ARMIJO: f64 = 1e-4;
/// Share of a value by which rounding may change it.
const ROUNDING: f64 = 1e-15;
/// Share of the slope that may be left after a step.
const WOLFE: f64 = 0.9;
/// Cosine between a step and the change of the gradient below which the pair says nothing.
const LEAST_COSINE: f64 = 1e-8;

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The value went down.
    Taken,
    /// No lower value was found: the point is a minimum as far as values can tell.
    NoDescent,
}

/// A minimisation under way.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimiser {
    point: Point,
    pairs: VecDeque<Pair>,
    bounds: Bounds,
    settings: MinimiserSettings,
    values: usize,
}

impl Minimiser {
    /// Start at `x`, brought within the bounds.
    ///
    /// # Errors
    /// Those of the function.
    pub fn start(
        function: &mut dyn Function,
        x: &[f64],
        bounds: Bounds,
        settings: MinimiserSettings,
    ) -> Result<Self> {
        let x: Vec<f64> = x.iter().enumerate().map(|(i, &value)| bounds.clamp(i, value)).collect();
        let value = function.value(&x)?;
        let gradient = function.gradient()?;
        let point = Point { x, value, gradient };
        Ok(Self { point, pairs: VecDeque::new(), bounds, settings, values: 1 })
    }

    /// Go on from a point with what is remembered of the steps before it.
    pub fn resume(
        point: Point,
        pairs: Vec<Pair>,
        bounds: Bounds,
        settings: MinimiserSettings,
    ) -> Self {
        Self { point, pairs: pairs.into(), bounds, settings, values: 0 }
    }

    /// Where it stands.
    pub fn point(&self) -> &Point {
        &self.point
    }

    /// The steps that are remembered, the oldest first.
    pub fn pairs(&self) -> impl ExactSizeIterator<Item = &Pair> {
        self.pairs.iter()
    }

    /// Number of values asked for so far.
    pub fn values(&self) -> usize {
        self.values
    }

    /// The largest component of the gradient over the variables that are free.
    pub fn free_gradient(&self) -> f64 {
        let free = self.free();
        let sizes = self.point.gradient.iter().zip(&free);
        sizes.filter(|(_, free)| **free).map(|(g, _)| g.abs()).fold(0.0, f64::max)
    }

    /// Take one step.
    ///
    /// # Errors
    /// Those of the function.
    pub fn step(&mut self, function: &mut dyn Function) -> Result<Step> {
        let free = self.free();
        let guided = self.direction(function, &free).filter(|d| self.descends(d));
        if let Some(direction) = guided {
            if self.search(function, &direction, 1.0)? == Step::Taken {
                return Ok(Step::Taken);
            }
            self.pairs.clear();
        }
        let mut downhill =
            function.preconditioned(&self.point.x, restricted(&self.point.gradient, &free), &free);
        downhill.iter_mut().for_each(|d| *d = -*d);
        let steepest = downhill.iter().fold(0.0_f64, |largest, d| largest.max(d.abs()));
        if steepest == 0.0 {
            return Ok(Step::NoDescent);
        }
        self.search(function, &downhill, self.settings.first_change / steepest)
    }

    /// Which variables may move downhill.
    fn free(&self) -> Vec<bool> {
        let Bounds { lower, upper } = &self.bounds;
        let Point { x, gradient, .. } = &self.point;
        (0..x.len())
            .map(|i| {
                let outwards = (x[i] <= lower[i] && gradient[i] >= 0.0)
                    || (x[i] >= upper[i] && gradient[i] <= 0.0);
                !outwards
            })
            .collect()
    }

    fn descends(&self, direction: &[f64]) -> bool {
        let gradient = &self.point.gradient;
        let sizes = (dot(gradient, gradient) * dot(direction, direction)).sqrt();
        dot(gradient, direction) < -LEAST_COSINE * sizes
    }

    /// The two-loop recursion on the free variables; `None` where no pair has a say.
    fn direction(&self, function: &dyn Function, free: &[bool]) -> Option<Vec<f64>> {
        let mut pairs = Vec::new();
        for pair in self.pairs.iter().rev() {
            let (step, change) = (restricted(&pair.step, free), restricted(&pair.change, free));
            let curvature = dot(&step, &change);
            let sizes = (dot(&step, &step) * dot(&change, &change)).sqrt();
            if curvature > LEAST_COSINE * sizes {
                pairs.push((step, change, curvature));
            }
        }
        let (_, change, curvature) = pairs.first()?;
        let preconditioned = |vector| function.preconditioned(&self.point.x, vector, free);
        let scale = curvature / dot(change, &preconditioned(change.clone()));
        let mut direction = restricted(&self.point.gradient, free);
        let mut shares = Vec::new();
        for (step, change, curvature) in &pairs {
            let share = dot(step, &direction) / curvature;
            add(&mut direction, -share, change);
            shares.push(share);
        }
        direction = preconditioned(direction);
        direction.iter_mut().for_each(|d| *d *= scale);
        for ((step, change, curvature), share) in pairs.iter().zip(shares).rev() {
            let correction = share - dot(change, &direction) / curvature;
            add(&mut direction, correction, step);
        }
        direction.iter_mut().for_each(|d| *d = -*d);
        Some(direction)
    }

    /// Search along the projected path from a first length. A length whose value is not
    /// low enough is cut by a parabola; one after which the path still goes steeply down
    /// is stretched by the secant of the slopes, as long as that pays.
    fn search(
        &mut self,
        function: &mut dyn Function,
        direction: &[f64],
        first: f64,
    ) -> Result<Step> {
        let mut length = first;
        let mut best: Option<Point> = None;
        for _ in 0..self.settings.values {
            let x = self.along(direction, length);
            let step = difference(&x, &self.point.x);
            let promised = dot(&self.point.gradient, &step);
            if step.iter().all(|change| *change == 0.0) {
                break;
            }
            let value = function.value(&x)?;
            self.values += 1;
            let rounding = ROUNDING * self.point.value.abs();
            let enough = value <= self.point.value + ARMIJO * promised + rounding;
            if let Some(shorter) = &best {
                if !(enough && value < shorter.value) {
                    break;
                }
            } else if !enough {
                let parabola = -promised / (2.0 * (value - self.point.value - promised));
                let parabola = if parabola.is_finite() { parabola } else { 0.1 };
                length *= parabola.clamp(0.1, 0.5);
                continue;
            }
            let gradient = function.gradient()?;
            let left = dot(&gradient, &step) / promised;
            best = Some(Point { x, value, gradient });
            if left <= WOLFE {
                break;
            }
            let secant = if left < 1.0 { 1.0 / (1.0 - left) } else { f64::INFINITY };
            length *= secant.clamp(2.0, 8.0);
        }
        let Some(point) = best else { return Ok(Step::NoDescent) };
        self.remember(&point);
        self.point = point;
        Ok(Step::Taken)
    }

    fn along(&self, direction: &[f64], length: f64) -> Vec<f64> {
        let moved = self.point.x.iter().zip(direction).map(|(x, d)| x + length * d);
        moved.enumerate().map(|(i, value)| self.bounds.clamp(i, value)).collect()
    }

    fn remember(&mut self, next: &Point) {
        let step = difference(&next.x, &self.point.x);
        let change = difference(&next.gradient, &self.point.gradient);
        let sizes = (dot(&step, &step) * dot(&change, &change)).sqrt();
        if dot(&step, &change) > LEAST_COSINE * sizes {
            self.pairs.push_back(Pair { step, change });
            while self.pairs.len() > self.settings.memory {
                self.pairs.pop_front();
            }
        }
    }
}

/// A vector with 0 where variables are not free.
fn restricted(vector: &[f64], free: &[bool]) -> Vec<f64> {
    vector.iter().zip(free).map(|(v, &free)| if free { *v } else { 0.0 }).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn add(to: &mut [f64], factor: f64, vector: &[f64]) {
    to.iter_mut().zip(vector).for_each(|(to, v)| *to += factor * v);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's function in many variables and its derivatives.
    struct Rosenbrock {
        x: Vec<f64>,
    }

    impl Function for Rosenbrock {
        fn value(&mut self, x: &[f64]) -> Result<f64> {
            self.x = x.to_vec();
            let terms =
                x.windows(2).map(|p| 100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2));
            Ok(terms.sum())
        }

        fn gradient(&mut self) -> Result<Vec<f64>> {
            let x = &self.x;
            let mut gradient = vec![0.0; x.len()];
            for i in 0..x.len() - 1 {
                let valley = x[i + 1] - x[i] * x[i];
                gradient[i] += -400.0 * x[i] * valley - 2.0 * (1.0 - x[i]);
                gradient[i + 1] += 200.0 * valley;
            }
            Ok(gradient)
        }
    }

    fn minimise(start: &[f64], bounds: Bounds, steps: usize) -> Minimiser {
        let mut function = Rosenbrock { x: Vec::new() };
        let settings = MinimiserSettings { first_change: 0.1, ..Default::default() };
        let mut minimiser = Minimiser::start(&mut function, start, bounds, settings).unwrap();
        for _ in 0..steps {
            if minimiser.step(&mut function).unwrap() == Step::NoDescent
                || minimiser.free_gradient() < 1e-5
            {
                break;
            }
        }
        minimiser
    }

    /// Lowest values, points and numbers of values by SciPy 1.17.1,
    /// `minimize(rosen, x0, jac=rosen_der, method="L-BFGS-B", options=dict(ftol=1e-16,
    /// gtol=1e-10))`, from (-1.2, 1, -1.2, 1, ...) in ten variables; the two with bounds
    /// agree with `method="trust-constr"` to 2e-11.
    #[test]
    fn rosenbrock_within_bounds_as_by_scipy() {
        let start = [-1.2, 1.0].repeat(5);
        let free = Bounds { lower: vec![f64::NEG_INFINITY; 10], upper: vec![f64::INFINITY; 10] };
        let cut = (0..10).map(|i| if i % 3 == 0 { 0.8 } else { 3.0 }).collect();
        let cut = Bounds { lower: vec![-2.0; 10], upper: cut };
        let lower = [-0.5, 0.5, -0.5, 0.5, -0.5, -1.0, -1.0, -1.0, -1.0, -1.0];
        let upper = [0.9, 0.9, 0.9, 0.9, 0.9, 2.0, 2.0, 2.0, 2.0, 2.0];
        let corner = Bounds { lower: lower.into(), upper: upper.into() };
        let cases = [
            (free, 0.0, [1.0, 1.0, 1.0], 94),
            (cut, 6.001_016_394_606, [0.8, 0.665_886_49, 0.460_333_65], 43),
            (corner, 26.115_500_796_256, [-0.5, 0.509_551_17, 0.509_515_9], 23),
        ];
        for (bounds, lowest, first, values) in cases {
            let minimiser = minimise(&start, bounds, 500);
            let point = minimiser.point();
            assert!((point.value - lowest).abs() < 1e-9, "{} {lowest}", point.value);
            for (x, expected) in point.x.iter().zip(first) {
                assert!((x - expected).abs() < 1e-6, "{x} {expected}");
            }
            assert!(minimiser.values() <= 2 * values, "{} values, {values}", minimiser.values());
        }
    }

    /// A bowl a million times steeper one way than the other, whose second derivatives are known.
    struct Bowl {
        x: Vec<f64>,
        known: bool,
    }

    impl Function for Bowl {
        fn value(&mut self, x: &[f64]) -> Result<f64> {
            self.x = x.to_vec();
            Ok(x.iter().enumerate().map(|(i, x)| 0.5 * 10_f64.powi(i as i32) * x * x).sum())
        }

        fn gradient(&mut self) -> Result<Vec<f64>> {
            Ok(self.x.iter().enumerate().map(|(i, x)| 10_f64.powi(i as i32) * x).collect())
        }

        fn preconditioned(&self, _x: &[f64], vector: Vec<f64>, _free: &[bool]) -> Vec<f64> {
            let steepness = |i: usize| if self.known { 3.0 * 10_f64.powi(i as i32) } else { 1.0 };
            vector.iter().enumerate().map(|(i, value)| value / steepness(i)).collect()
        }
    }

    #[test]
    fn what_is_known_of_a_function_leads_straight_down() {
        let reached = |known: bool, steps: usize| {
            let mut bowl = Bowl { x: Vec::new(), known };
            let bounds = Bounds { lower: vec![-9.0; 7], upper: vec![9.0; 7] };
            let settings = MinimiserSettings::default();
            let mut minimiser = Minimiser::start(&mut bowl, &[1.0; 7], bounds, settings).unwrap();
            for _ in 0..steps {
                minimiser.step(&mut bowl).unwrap();
            }
            minimiser.point().value
        };
        assert!(reached(true, 2) < 1e-12, "{}", reached(true, 2));
        assert!(reached(false, 8) > 1e-2, "{}", reached(false, 8));
    }

    #[test]
    fn a_minimisation_goes_on_where_it_was() {
        let bounds = || Bounds { lower: vec![-2.0; 6], upper: vec![0.9; 6] };
        let start = [-1.2, 0.9, 0.1, -0.3, 0.5, 0.0];
        let whole = minimise(&start, bounds(), 12);
        let half = minimise(&start, bounds(), 5);
        let (point, pairs) = (half.point().clone(), half.pairs().cloned().collect());
        let settings = MinimiserSettings { first_change: 0.1, ..Default::default() };
        let mut rest = Minimiser::resume(point, pairs, bounds(), settings);
        let mut function = Rosenbrock { x: Vec::new() };
        for _ in 5..12 {
            assert_eq!(rest.step(&mut function).unwrap(), Step::Taken);
        }
        assert_eq!(rest.point(), whole.point());
    }

    #[test]
    fn at_a_minimum_there_is_no_step() {
        let bounds = Bounds { lower: vec![2.0; 2], upper: vec![3.0; 2] };
        // Both derivatives of (x1 - x0^2)^2 push x0 down to its bound and x1 up to its own.
        let minimiser = minimise(&[2.5, 2.5], bounds, 50);
        assert_eq!(minimiser.point().x, [2.0, 3.0]);
        let mut function = Rosenbrock { x: vec![2.0, 3.0] };
        assert_eq!(minimiser.clone().step(&mut function).unwrap(), Step::NoDescent);
    }
}
