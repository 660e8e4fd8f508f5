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
#[non_exhaustive]
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

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn add(to: &mut [f64], factor: f64, vector: &[f64]) {
    to.iter_mut().zip(vector).for_each(|(to, v)| *to += factor * v);
}

#[cfg(test)]
mod tests;
