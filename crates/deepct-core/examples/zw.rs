//! zw
use deepct_core::scene::*; use deepct_core::transport::*; use deepct_core::optics::*; use deepct_core::io::*;
fn main(){
  let a:Vec<String>=std::env::args().collect();
  let cloud=read_cloud(&a[1]).unwrap();
  let v=read_volume(&a[1]).unwrap();
  let _=cloud;
  let m=Medium::new(v.clone(),1.0,PhaseFunction::henyey_greenstein(0.86).unwrap()).unwrap();
  let scene=Scene::new(m,Sun::from_degrees(30.,45.).unwrap(),Surface::lambertian(0.0)).unwrap();
  let views=Formation::cloudct_10().views(v.grid.center(),[32,32]).unwrap();
  let refer=render(&scene,&views,&Solver::Ordinates(OrdinatesSettings{zenith_angles:8,cell_depth:1.25,..Default::default()}),&()).unwrap().images;
  for (cd,n,tol) in [(2.5,8,1e-4),(2.5,8,1e-3),(5.0,8,1e-3),(10.0,8,1e-3),(5.0,4,1e-3)] {
    let t=std::time::Instant::now();
    let r=render(&scene,&views,&Solver::Ordinates(OrdinatesSettings{zenith_angles:n,cell_depth:cd,tolerance:tol,..Default::default()}),&()).unwrap().images;
    let s=t.elapsed().as_secs_f64();
    let mut worst=0f32; let mut l1=0f32;
    for k in 0..10 { let (x,y)=(r.image(k),refer.image(k)); worst=worst.max((x.sum()/y.sum()-1.0).abs()); l1+=(&x-&y).mapv(f32::abs).sum()/y.sum()/10.0; }
    println!("cell_depth {cd} n {n} tol {tol}: {s:.2} s, worst mean {:.3} %, L1 {:.3} %", 100.0*worst, 100.0*l1);
  }
}
