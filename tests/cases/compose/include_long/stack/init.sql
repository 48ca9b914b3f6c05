create table poses;
