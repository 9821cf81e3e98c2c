use std::collections::BTreeMap;
use contract::device::camera::*;
use contract::*;
use node_archive::*;
#[tokio::test(flavor = "multi_thread")]
async fn bench() {
    let folder = tempfile::tempdir_in("/work/target-arch-venv").unwrap();
    let text = "[observatory]\nsite='a'\ntelescope='b'\nlatitude_deg=-24.6\nlongitude_deg=-70.4\nelevation_m=2500\n[[telescope]]\nname='mount'\nserver='l:1'\n[[camera]]\nname='andor'\nserver='l:1'\n[[focuser]]\nname='foc'\nserver='l:1'\n[[dome]]\nname='dome'\nserver='l:1'\n[[observingconditions]]\nname='wx'\nserver='l:1'\n[[filterwheel]]\nname='fw'\nserver='l:1'\n";
    let config = config::parse(text, folder.path()).unwrap();
    let table = config::header::HeaderTable::default();
    let (db, w) = database::Database::open(&config.archive.database, bus::AlertBoard::new(bus::Clock::machine_clock())).unwrap();
    let t0: units::Utc = "2026-11-21T03:00:00Z".parse().unwrap();
    let boot = BootId::fresh();
    for s in 0..400 { for (kind,name) in [(Kind::Telescope,"mount"),(Kind::Camera,"andor"),(Kind::Focuser,"foc"),(Kind::Dome,"dome"),(Kind::ObservingConditions,"wx"),(Kind::FilterWheel,"fw")] {
        let d = config.address().device(kind, &name.parse().unwrap());
        for p in table.properties(kind,false).into_iter().chain(if s==0 {table.properties(kind,true)} else {vec![]}) { db.put(database::Write::Reading{device:d.clone(),property:p,value:Ok(Scalar::Float(s as f64)),at:t0.plus_seconds(s as f64*5.0),said:(boot.clone(),s)}).await.unwrap(); }
    }}
    let shape = fits::Shape{pixel:Pixel::U16,width_px:1024,height_px:1024,planes:1};
    let px = vec![1u8; 2<<20];
    std::fs::create_dir_all(&config.folders.images).unwrap();
    let mut images = vec![];
    for i in 0..100 {
        let path = config.folders.images.join(format!("{i}.fits"));
        let frame = Frame{id:CommandId(format!("f{i}")),camera:"andor".into(),purpose:Purpose{ra_deg:Some(84.0),dec_deg:Some(-69.0),..Default::default()},width_px:1024,height_px:1024,planes:1,pixel:Pixel::U16,bin:1,origin_px:[0,0],started_utc:t0.plus_seconds(3.0+i as f64*6.0),exposure_s:5.0,url:String::new(),bytes:2<<20,sha256:String::new(),readings:BTreeMap::new()};
        let cards = header::base(&table,&header::Known{frame:&frame,place:&config.place,written:t0,newest:&|_,_|None});
        let t=std::time::Instant::now();
        let mut f = fits::FitsFile::create(&path,&shape).unwrap();
        for c in &cards { f.set(c).unwrap(); }
        f.reserve(header::room(&table)).unwrap(); f.write_pixels(&shape,&px).unwrap(); f.write_checksums().unwrap(); f.close().unwrap();
        if i==50 {println!("write {:?}", t.elapsed());}
        images.push(database::StoredImage{frame,path,file:format!("{i}.fits"),bytes:0,stored:t0});
    }
    db.commit(images.iter().map(|i| database::Write::Stored(Box::new(i.clone()))).collect()).await.unwrap();
    let reader = reader::Reader::open(db.path()).unwrap();
    let newest = telemetry::Newest::default();
    let site = pass::Site{config:&config,table:&table,newest:&newest,speed:1.0};
    let t=std::time::Instant::now();
    let mut cards=0; let mut hist=vec![];
    for i in reader.incomplete(1000).unwrap() { let p = pass::complete_image(&site,&reader,&i,true).unwrap().unwrap(); cards=p.cards.len(); hist=p.history; }
    db.commit(images.iter().map(|i| database::Write::Complete(i.frame.id.clone())).collect()).await.unwrap();
    println!("100 headers {:?} {cards} {hist:?}", t.elapsed());
    let t=std::time::Instant::now();
    for i in &images { completion::complete_file(&i.path,&header::Plan::default()).unwrap(); }
    println!("100 empty {:?}", t.elapsed());
    std::fs::copy(&images[7].path,"/tmp/arch-y/full.fits").unwrap();
    drop(db); w.end().await;
}
