<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22" styleCategories="Symbology">
  <renderer type="classified" attribute="Classification" pointSize="1" pointSizeUnit="MM" pointSymbol="0" maximumScreenError="0.3" maximumScreenErrorUnit="MM">
    <categories>
      <category render="true" value="2" color="176,141,87,255" label="Ground"/>
      <category render="true" value="1" color="96,125,139,255" label="Not ground"/>
      <category render="true" value="0" color="96,125,139,255" label="Never classified"/>
      <category render="true" value="3" color="173,208,110,255" label="Low vegetation"/>
      <category render="true" value="4" color="106,168,79,255" label="Medium vegetation"/>
      <category render="true" value="5" color="39,108,42,255" label="High vegetation"/>
      <category render="true" value="6" color="200,70,50,255" label="Building"/>
      <category render="true" value="7" color="230,0,180,255" label="Low noise"/>
      <category render="true" value="9" color="60,130,220,255" label="Water"/>
      <category render="true" value="17" color="240,160,40,255" label="Bridge deck"/>
      <category render="true" value="18" color="230,0,180,255" label="High noise"/>
    </categories>
  </renderer>
</qgis>
