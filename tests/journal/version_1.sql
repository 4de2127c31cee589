BEGIN TRANSACTION;
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0001');
CREATE TABLE command (
	row_id INTEGER NOT NULL, 
	command_id TEXT NOT NULL, 
	telescope TEXT NOT NULL, 
	utc DATETIME NOT NULL, 
	"order" VARCHAR(32) NOT NULL, 
	to_ra_deg FLOAT, 
	to_dec_deg FLOAT, 
	to_frame VARCHAR(16), 
	to_place_utc DATETIME, 
	facts JSON NOT NULL, 
	before_ra_deg FLOAT, 
	before_dec_deg FLOAT, 
	before_frame VARCHAR(16), 
	before_place_utc DATETIME, 
	before_utc DATETIME, 
	before_slewing BOOLEAN, 
	before_tracking BOOLEAN, 
	before_parked BOOLEAN, 
	before_at_home BOOLEAN, 
	before_pier_side VARCHAR(16), 
	segment_id TEXT NOT NULL, 
	run_id VARCHAR(64) NOT NULL, 
	cause_job_id TEXT, 
	cause_night_id TEXT, 
	cause_look_id TEXT, 
	why TEXT NOT NULL, 
	ended_utc DATETIME, 
	outcome VARCHAR(32), 
	end_detail TEXT, 
	after_ra_deg FLOAT, 
	after_dec_deg FLOAT, 
	after_frame VARCHAR(16), 
	after_place_utc DATETIME, 
	after_utc DATETIME, 
	after_slewing BOOLEAN, 
	after_tracking BOOLEAN, 
	after_parked BOOLEAN, 
	after_at_home BOOLEAN, 
	after_pier_side VARCHAR(16), 
	miss_arcsec FLOAT, 
	end_facts JSON, 
	PRIMARY KEY (row_id), 
	UNIQUE (command_id)
);
INSERT INTO "command" VALUES(1,'command-1','east','2026-11-22 03:12:45.123456','slew',120.0,40.0,'apparent','2026-11-22 03:12:45.123456','{}',100.0,20.0,'apparent','2026-11-22 03:12:45.123456','2026-11-22 03:12:45.123456',NULL,NULL,NULL,NULL,NULL,'segment','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'','2026-11-22 03:13:05.123456','done','',120.0,40.0,'apparent','2026-11-22 03:12:45.123456','2026-11-22 03:12:47.123456',NULL,NULL,NULL,NULL,'west',3.5,'{"tries": 1}');
INSERT INTO "command" VALUES(2,'command-2','east','2026-11-22 03:13:55.123456','slew',120.0,40.0,'apparent','2026-11-22 03:13:55.123456','{}',100.0,20.0,'apparent','2026-11-22 03:13:55.123456','2026-11-22 03:13:55.123456',NULL,NULL,NULL,NULL,NULL,'segment','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'',NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL);
CREATE TABLE entry (
	row_id INTEGER NOT NULL, 
	telescope TEXT NOT NULL, 
	utc DATETIME NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	what TEXT NOT NULL, 
	facts JSON NOT NULL, 
	run_id VARCHAR(64) NOT NULL, 
	cause_job_id TEXT, 
	cause_night_id TEXT, 
	cause_look_id TEXT, 
	why TEXT NOT NULL, 
	PRIMARY KEY (row_id)
);
INSERT INTO "entry" VALUES(1,'','2026-11-22 06:17:55.025445','service','mountnav 0.1.0 started','{"version": "0.1.0", "host": "dome", "pid": 8613}','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'');
INSERT INTO "entry" VALUES(2,'','2026-11-22 06:17:55.025445','settings','the configuration is written down','{"sha256": "0d445f1deba8fe4a29b57db14fed036490013c9275905b5342dddc92e49af5b0", "changes": [], "more": false}','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'');
INSERT INTO "entry" VALUES(3,'east','2026-11-22 03:14:05.123456','fault','stopped at a limit','{"limit": "altitude", "degrees": [15.0, null, "\u2033"]}','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'');
CREATE TABLE look (
	row_id INTEGER NOT NULL, 
	look_id TEXT NOT NULL, 
	telescope TEXT NOT NULL, 
	utc DATETIME NOT NULL, 
	solved BOOLEAN NOT NULL, 
	reason TEXT NOT NULL, 
	detail TEXT NOT NULL, 
	seen_ra_deg FLOAT, 
	seen_dec_deg FLOAT, 
	covariance_east_arcsec2 FLOAT, 
	covariance_cross_arcsec2 FLOAT, 
	covariance_north_arcsec2 FLOAT, 
	before_ra_deg FLOAT, 
	before_dec_deg FLOAT, 
	before_frame VARCHAR(16), 
	before_place_utc DATETIME, 
	before_utc DATETIME, 
	before_slewing BOOLEAN, 
	before_tracking BOOLEAN, 
	before_parked BOOLEAN, 
	before_at_home BOOLEAN, 
	before_pier_side VARCHAR(16), 
	after_ra_deg FLOAT, 
	after_dec_deg FLOAT, 
	after_frame VARCHAR(16), 
	after_place_utc DATETIME, 
	after_utc DATETIME, 
	after_slewing BOOLEAN, 
	after_tracking BOOLEAN, 
	after_parked BOOLEAN, 
	after_at_home BOOLEAN, 
	after_pier_side VARCHAR(16), 
	segment_id TEXT NOT NULL, 
	model_id TEXT, 
	pressure_hpa FLOAT, 
	temperature_c FLOAT, 
	relative_humidity FLOAT, 
	wavelength_um FLOAT, 
	dut1_s FLOAT, 
	camera TEXT NOT NULL, 
	source TEXT NOT NULL, 
	exposure_s FLOAT, 
	mode TEXT NOT NULL, 
	catalog TEXT NOT NULL, 
	pairs INTEGER NOT NULL, 
	rms_arcsec FLOAT, 
	false_probability FLOAT, 
	scale_arcsec_px FLOAT, 
	rotation_deg FLOAT, 
	parity INTEGER, 
	fwhm_px FLOAT, 
	limiting_mag FLOAT, 
	sky_adu FLOAT, 
	measured INTEGER NOT NULL, 
	used TEXT NOT NULL, 
	run_id VARCHAR(64) NOT NULL, 
	cause_job_id TEXT, 
	cause_night_id TEXT, 
	cause_look_id TEXT, 
	why TEXT NOT NULL, 
	PRIMARY KEY (row_id), 
	UNIQUE (look_id)
);
INSERT INTO "look" VALUES(1,'look-1','east','2026-11-22 03:12:45.123456',1,'','',120.01,40.01,0.04,0.01,0.09,120.0,40.0,'apparent','2026-11-22 03:12:45.123456','2026-11-22 03:12:43.123456',NULL,1,NULL,NULL,NULL,120.0,40.0,'apparent','2026-11-22 03:12:45.123456','2026-11-22 03:12:47.123456',NULL,NULL,NULL,NULL,'west','segment',NULL,1010.0,10.0,0.5,0.6,0.0,'','',0.0,'','',42,0.4,NULL,NULL,NULL,NULL,NULL,NULL,NULL,0,'','3f874ea1cbf24f258f17be24bbaca64a','job-1',NULL,NULL,'centering');
INSERT INTO "look" VALUES(2,'look-2','east','2026-11-22 03:13:45.123456',0,'too-few-sources','3 sources',NULL,NULL,NULL,NULL,NULL,120.0,40.0,'apparent','2026-11-22 03:13:45.123456','2026-11-22 03:13:43.123456',NULL,1,NULL,NULL,NULL,120.0,40.0,'apparent','2026-11-22 03:13:45.123456','2026-11-22 03:13:47.123456',NULL,NULL,NULL,NULL,'west','segment',NULL,1010.0,10.0,0.5,0.6,0.0,'','',0.0,'','',0,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,0,'','3f874ea1cbf24f258f17be24bbaca64a',NULL,NULL,NULL,'');
CREATE TABLE run (
	run_id VARCHAR(64) NOT NULL, 
	started_utc DATETIME NOT NULL, 
	ended_utc DATETIME, 
	version TEXT NOT NULL, 
	host TEXT NOT NULL, 
	pid INTEGER NOT NULL, 
	settings_sha256 VARCHAR(64) NOT NULL, 
	settings TEXT NOT NULL, 
	PRIMARY KEY (run_id)
);
INSERT INTO "run" VALUES('3f874ea1cbf24f258f17be24bbaca64a','2026-11-22 06:17:55.025445',NULL,'0.1.0','dome',8613,'0d445f1deba8fe4a29b57db14fed036490013c9275905b5342dddc92e49af5b0','[site]
latitude_deg = 47.0');
CREATE INDEX look_by_time ON look (telescope, utc);
CREATE INDEX look_of_all_by_time ON look (utc);
CREATE INDEX command_by_time ON command (telescope, utc);
CREATE INDEX command_of_all_by_time ON command (utc);
CREATE INDEX entry_by_time ON entry (telescope, kind, utc);
CREATE INDEX entry_of_all_by_time ON entry (utc);
COMMIT;
