//! Bounded quasi-Newton minimisation: limited-memory BFGS in the free variables, with a line search
//! along the path projected onto the bounds.
//!
//! A variable is free unless it is at a bound and the gradient pushes it outwards (Bertsekas 1982,
//! "Projected Newton methods for optimization problems with simple constraints"). For the free
//! variables, the direction is given by the two-loop recursion (Nocedal 1980) over the last steps,
//! each restricted to these variables, with the initial inverse Hessian of the function itself
//! ([`Function::preconditioned`]). The step is projected onto the bounds. It is accepted if it
//! decreases the value sufficiently (Armijo) and the slope along it has flattened (weak Wolfe). An
//! evaluation may take seconds, so the first trial step is accepted whenever possible.

use crate::error::Result;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A smooth function of many variables.
pub trait Function {
    /// Computes the value at `x`.
    ///
    /// # Errors
    /// The errors of the function.
    fn value(&mut self, x: &[f64]) -> Result<f64>;

    /// Computes the derivatives at the point of the last [`Function::value`].
    ///
    /// # Errors
    /// The errors of the function.
    fn gradient(&mut self) -> Result<Vec<f64>>;

    /// Multiplies a vector by an approximate inverse Hessian at `x`, up to a constant factor, among
    /// the free variables; the vector is 0 for all others. The default returns the vector
    /// unchanged.
    fn preconditioned(&self, _x: &[f64], vector: Vec<f64>, _free: &[bool]) -> Vec<f64> {
        vector
    }
}

/// Lower and upper bound of each variable; may be infinite.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    /// Lower bounds.
    pub lower: Vec<f64>,
    /// Upper bounds.
    pub upper: Vec<f64>,
}

impl Bounds {
    fn clamp(&self, index: usize, value: f64) -> f64 {
        value.max(self.lower[index]).min(self.upper[index])
    }
}

/// A point of a minimisation.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// The variables.
    pub x: Vec<f64>,
    /// The value at the point.
    pub value: f64,
    /// The derivatives at the point.
    pub gradient: Vec<f64>,
}

/// A step and the change of the gradient over it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Change of the variables.
    pub step: Vec<f64>,
    /// Change of the gradient.
    pub change: Vec<f64>,
}

/// Settings of [`Minimiser::step`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MinimiserSettings {
    /// Number of steps that are stored.
    pub memory: usize,
    /// The largest change of a variable in the first trial of a step without stored steps.
    pub first_change: f64,
    /// Maximum number of evaluations in one step.
    pub values: usize,
}

impl Default for MinimiserSettings {
    fn default() -> Self {
        Self { memory: 10, first_change: 1.0, values: 12 }
    }
}

/// Smallest decrease of an accepted step, relative to the decrease predicted from the slope.
const ARMIJO: f64 = 1e-4;
/// Relative change of a value by rounding errors.
const ROUNDING: f64 = 1e-15;
/// Slope, relative to that before the step, at or below which the search ends.
const WOLFE: f64 = 0.9;
/// Cosine between a step and the change of the gradient below which the pair is not used.
const LEAST_COSINE: f64 = 1e-8;

/// The result of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Step {
    /// The value decreased.
    Taken,
    /// No lower value was found: within the accuracy of the values, the point is a minimum.
    NoDescent,
}

/// A minimisation in progress.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimiser {
    point: Point,
    pairs: VecDeque<Pair>,
    bounds: Bounds,
    settings: MinimiserSettings,
    values: usize,
}

impl Minimiser {
    /// Starts at `x`, projected onto the bounds.
    ///
    /// # Errors
    /// The errors of the function.
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

    /// Resumes from a point with the steps stored before it and the number of evaluations so far.
    pub fn resume(
        point: Point,
        pairs: Vec<Pair>,
        bounds: Bounds,
        settings: MinimiserSettings,
        values: usize,
    ) -> Self {
        Self { point, pairs: pairs.into(), bounds, settings, values }
    }

    /// Stores another number of steps from now on.
    pub fn with_memory(self, memory: usize) -> Self {
        let settings = MinimiserSettings { memory, ..self.settings };
        Self { settings, ..self }
    }

    /// Begins again at `x`, within the bounds, with the stored steps: for a function with nearly the same
    /// second derivatives.
    ///
    /// # Errors
    /// The errors of the function.
    pub fn restart(&mut self, function: &mut dyn Function, x: &[f64]) -> Result<()> {
        self.point.x = x.to_vec();
        self.refresh(function)
    }

    /// Evaluates the function again at the current point, after it has changed.
    ///
    /// # Errors
    /// The errors of the function.
    pub fn refresh(&mut self, function: &mut dyn Function) -> Result<()> {
        self.point.value = function.value(&self.point.x)?;
        self.point.gradient = function.gradient()?;
        self.values += 1;
        Ok(())
    }

    /// The current point.
    pub fn point(&self) -> &Point {
        &self.point
    }

    /// The stored steps, the oldest first.
    pub fn pairs(&self) -> impl ExactSizeIterator<Item = &Pair> {
        self.pairs.iter()
    }

    /// Number of evaluations so far.
    pub fn values(&self) -> usize {
        self.values
    }

    /// The largest absolute component of the gradient over the free variables.
    pub fn free_gradient(&self) -> f64 {
        let free = self.free();
        let sizes = self.point.gradient.iter().zip(&free);
        sizes.filter(|(_, free)| **free).map(|(g, _)| g.abs()).fold(0.0, f64::max)
    }

    /// Takes one step.
    ///
    /// # Errors
    /// The errors of the function.
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

    /// Whether each variable is free.
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

    /// The two-loop recursion for the free variables; `None` if no stored pair is usable.
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

    /// Searches along the projected path, beginning with the length `first`. A length whose value
    /// is too high is reduced using a parabola. A length at which the path still descends steeply
    /// is increased using the secant of the slopes, as long as the value decreases.
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

/// A copy of a vector with 0 for variables that are not free.
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
