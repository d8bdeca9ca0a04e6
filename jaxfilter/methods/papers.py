"""The papers behind the methods, as BibTeX: what the filters name in ``BIBTEX``."""

AXELSSON_2000 = """@article{axelsson2000dem,
  author  = {Axelsson, Peter},
  title   = {{DEM} Generation from Laser Scanner Data Using Adaptive {TIN} Models},
  journal = {International Archives of Photogrammetry and Remote Sensing},
  volume  = {33},
  number  = {B4},
  pages   = {110--117},
  year    = {2000}
}"""

CAI_2023 = """@article{cai2023progressive,
  author  = {Cai, Shangshu and Liang, Xinlian and Yu, Sisi},
  title   = {A Progressive Plane Detection Filtering Method for Airborne {LiDAR} Data in Forested Landscapes},
  journal = {Forests},
  volume  = {14},
  number  = {3},
  pages   = {498},
  year    = {2023},
  doi     = {10.3390/f14030498}
}"""

CHEN_2023 = """@article{chen2023improved,
  author  = {Chen, Na and Wang, Nanmeng and He, Yi and Ding, Xiang and Kong, Jian},
  title   = {An Improved Progressive Triangular Irregular Network Densification Filtering Algorithm for Airborne
            {LiDAR} Data},
  journal = {Frontiers in Earth Science},
  volume  = {10},
  pages   = {1015153},
  year    = {2023},
  doi     = {10.3389/feart.2022.1015153}
}"""

LI_2021 = """@article{li2021fptd,
  author  = {Li, Hongfu and Ye, Chengming and Guo, Zixuan and Wei, Ruilong and Wang, Lixuan and Li, Jonathan},
  title   = {A Fast Progressive {TIN} Densification Filtering Algorithm for Airborne {LiDAR} Data Using Adjacent
             Surface Information},
  journal = {IEEE Journal of Selected Topics in Applied Earth Observations and Remote Sensing},
  volume  = {14},
  year    = {2021},
  doi     = {10.1109/JSTARS.2021.3131586}
}"""

PINGEL_2013 = """@article{pingel2013improved,
  author  = {Pingel, Thomas J. and Clarke, Keith C. and McBride, William A.},
  title   = {An Improved Simple Morphological Filter for the Terrain Classification of Airborne {LIDAR} Data},
  journal = {ISPRS Journal of Photogrammetry and Remote Sensing},
  volume  = {77},
  pages   = {21--30},
  year    = {2013},
  doi     = {10.1016/j.isprsjprs.2012.12.002}
}"""

URAY_2024 = """@article{uray2024filtering,
  author  = {Uray, F{\\i}rat and Varl{\\i}k, Abdullah},
  title   = {Filtering Airborne {LIDAR} Data Using Simple Triangulation Irregular Network},
  journal = {Necmettin Erbakan University Journal of Science and Engineering},
  volume  = {6},
  number  = {3},
  pages   = {495--511},
  year    = {2024},
  doi     = {10.47112/neufmbd.2024.61}
}"""

VOSSELMAN_2000 = """@article{vosselman2000slope,
  author  = {Vosselman, George},
  title   = {Slope Based Filtering of Laser Altimetry Data},
  journal = {International Archives of Photogrammetry and Remote Sensing},
  volume  = {33},
  number  = {B3/2},
  pages   = {935--942},
  year    = {2000}
}"""

ZHANG_2003 = """@article{zhang2003progressive,
  author  = {Zhang, Keqi and Chen, Shu-Ching and Whitman, Dean and Shyu, Mei-Ling and Yan, Jianhua and Zhang, Chengcui},
  title   = {A Progressive Morphological Filter for Removing Nonground Measurements from Airborne {LIDAR} Data},
  journal = {IEEE Transactions on Geoscience and Remote Sensing},
  volume  = {41},
  number  = {4},
  pages   = {872--882},
  year    = {2003},
  doi     = {10.1109/TGRS.2003.810682}
}"""

ZHANG_2013 = """@article{zhang2013filtering,
  author  = {Zhang, Jixian and Lin, Xiangguo},
  title   = {Filtering Airborne {LiDAR} Data by Embedding Smoothness-Constrained Segmentation in Progressive {TIN}
             Densification},
  journal = {ISPRS Journal of Photogrammetry and Remote Sensing},
  volume  = {81},
  pages   = {44--59},
  year    = {2013},
  doi     = {10.1016/j.isprsjprs.2013.04.001}
}"""

ZHANG_2016 = """@article{zhang2016easy,
  author  = {Zhang, Wuming and Qi, Jianbo and Wan, Peng and Wang, Hongtao and Xie, Donghui and Wang, Xiaoyan and
            Yan, Guangjian},
  title   = {An Easy-to-Use Airborne {LiDAR} Data Filtering Method Based on Cloth Simulation},
  journal = {Remote Sensing},
  volume  = {8},
  number  = {6},
  pages   = {501},
  year    = {2016},
  doi     = {10.3390/rs8060501}
}"""

ZHAO_2016 = """@article{zhao2016improved,
  author  = {Zhao, Xiaoqian and Guo, Qinghua and Su, Yanjun and Xue, Baolin},
  title   = {Improved Progressive {TIN} Densification Filtering Algorithm for Airborne {LiDAR} Data in Forested Areas},
  journal = {ISPRS Journal of Photogrammetry and Remote Sensing},
  volume  = {117},
  pages   = {79--91},
  year    = {2016},
  doi     = {10.1016/j.isprsjprs.2016.03.016}
}"""

ZHENG_2024 = """@article{zheng2024improved,
  author  = {Zheng, Jinjun and Xiang, Man and Zhang, Tao and Zhou, Ji},
  title   = {An Improved Adaptive Grid-Based Progressive Triangulated Irregular Network Densification Algorithm for
            Filtering Airborne {LiDAR} Data},
  journal = {Remote Sensing},
  volume  = {16},
  number  = {20},
  pages   = {3846},
  year    = {2024},
  doi     = {10.3390/rs16203846}
}"""
