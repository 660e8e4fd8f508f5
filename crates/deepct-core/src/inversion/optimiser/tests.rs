//! Tests with functions whose minima are known.

use super::*;

/// The Rosenbrock function of many variables and its derivatives.
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

/// Lowest values, points and numbers of evaluations from SciPy 1.17.1 with `minimize(rosen, x0,
/// jac=rosen_der, method="L-BFGS-B", options=dict(ftol=1e-16, gtol=1e-10))`, starting at (-1.2, 1,
/// -1.2, 1, ...) in ten variables. The two cases with bounds agree with `method="trust-constr"` to
/// 2e-11.
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

/// A quadratic function that is a million times steeper along one axis than along another and whose
/// second derivatives are known.
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
    let mut rest = Minimiser::resume(point, pairs, bounds(), settings, 0);
    let mut function = Rosenbrock { x: Vec::new() };
    for _ in 5..12 {
        assert_eq!(rest.step(&mut function).unwrap(), Step::Taken);
    }
    assert_eq!(rest.point(), whole.point());
}

#[test]
fn at_a_minimum_there_is_no_step() {
    let bounds = Bounds { lower: vec![2.0; 2], upper: vec![3.0; 2] };
    // Both derivatives of (x1 - x0^2)^2 push x0 to its lower bound and x1 to its upper bound.
    let minimiser = minimise(&[2.5, 2.5], bounds, 50);
    assert_eq!(minimiser.point().x, [2.0, 3.0]);
    let mut function = Rosenbrock { x: vec![2.0, 3.0] };
    assert_eq!(minimiser.clone().step(&mut function).unwrap(), Step::NoDescent);
}

/// A quadratic function of ten variables, between 1 and 1000 times as steep along each, whose minimum is
/// at `center`.
struct Ellipsoid {
    center: f64,
    x: Vec<f64>,
}

impl Ellipsoid {
    fn terms(&self) -> impl Iterator<Item = (f64, f64)> {
        let steepness = |i: usize| 1000.0_f64.powf(i as f64 / 9.0);
        self.x.iter().enumerate().map(move |(i, x)| (steepness(i), x - self.center))
    }
}

impl Function for Ellipsoid {
    fn value(&mut self, x: &[f64]) -> Result<f64> {
        self.x = x.to_vec();
        Ok(self.terms().map(|(steepness, x)| 0.5 * steepness * x * x).sum())
    }

    fn gradient(&mut self) -> Result<Vec<f64>> {
        Ok(self.terms().map(|(steepness, x)| steepness * x).collect())
    }
}

#[test]
fn stored_steps_serve_a_function_with_the_same_second_derivatives() {
    let start = [1.0; 10];
    let bounds = Bounds { lower: vec![f64::NEG_INFINITY; 10], upper: vec![f64::INFINITY; 10] };
    let steps = |function: &mut Ellipsoid, minimiser: &mut Minimiser| {
        let mut steps = 0;
        while minimiser.free_gradient() > 1e-6 {
            minimiser.step(function).unwrap();
            steps += 1;
        }
        let center = function.center;
        assert!(minimiser.point().x.iter().all(|x| (x - center).abs() < 1e-5));
        steps
    };
    let mut function = Ellipsoid { center: 0.0, x: Vec::new() };
    let settings = MinimiserSettings::default();
    let minimiser = Minimiser::start(&mut function, &start, bounds, settings).unwrap();
    let mut minimiser = minimiser.with_memory(40);
    let first = steps(&mut function, &mut minimiser);
    function.center = -2.0;
    minimiser.restart(&mut function, &start).unwrap();
    let again = steps(&mut function, &mut minimiser);
    assert!(2 * again < first, "{again} steps after {first}");
}
