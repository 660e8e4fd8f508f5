//! Scores: how far an estimate is from the truth.
